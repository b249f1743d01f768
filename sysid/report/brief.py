"""Results in a few lines: a head, a table, and what to mind; as text for a terminal and as HTML for a
notebook."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.report.text import clean, in_words, measured, row, verdict

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.posterior.change import Change
    from sysid.posterior.circuit import Circuit
    from sysid.posterior.foreseen import Raised
    from sysid.posterior.planning import Advice
    from sysid.posterior.posterior import Posterior
    from sysid.posterior.prediction import Prediction
    from sysid.verdict.comparison import Comparison
    from sysid.verdict.fitted import Fit
    from sysid.verdict.result import Parameter

WIDTH = 100  # characters of a line
LINES = 12  # of a text
PARAMETERS = ("parameter", "value", "95 % interval", "unit")
Row = tuple[str, ...]


@dataclass(frozen=True)
class Brief:
    """What a result shows of itself: `rows` below their header `names`, which a text has where it is
    `headed`; `inline`: a text is the head alone, as of results that come in lists."""

    head: str
    names: Row = ()
    rows: tuple[Row, ...] = ()
    tail: tuple[str, ...] = ()
    inline: bool = False
    headed: bool = False

    def text(self) -> str:
        """At most LINES lines of plain text; a head of more than WIDTH characters goes on in the next
        line."""
        if self.inline:
            return clean(" ".join(self.head.split()))
        head = wrap(clean(self.head), WIDTH, subsequent_indent="  ")
        table = (self.names, *self.rows) if self.headed else self.rows
        room = LINES - len(head)  # the tail has what the table leaves
        rows = table if len(table) <= room else table[: room - 1]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(c.ljust(w) for c, w in zip(cells, widths, strict=True)).rstrip() for cells in rows]
        lines += [f"and {len(table) - len(rows)} more"] if len(rows) < len(table) else []
        below = [*lines, *self.tail][:room]
        return "\n".join([*head, *(_cut(f"  {clean(line)}") for line in below)])

    def html(self) -> str:
        """The same as HTML, nothing of it cut."""
        cells = "".join(
            f"<tr>{''.join(f'<td>{_escaped(c)}</td>' for c in cells)}</tr>" for cells in self.rows
        )
        heads = "".join(f"<th>{_escaped(name)}</th>" for name in self.names)
        table = f"<table><thead><tr>{heads}</tr></thead><tbody>{cells}</tbody></table>" if self.rows else ""
        tail = "".join(f"<p>{_escaped(line)}</p>" for line in self.tail)
        return f"<div><p>{_escaped(self.head)}</p>{table}{tail}</div>"


def of_fit(fit: "Fit") -> Brief:
    """Of a fit."""
    tail = [*_counted(fit), *_open(fit.parameters), *fit.warnings]
    return _identified("Fit", fit, fit.result.value, fit.parameters, tail)


def of_posterior(posterior: "Posterior") -> Brief:
    """Of a posterior: its own parameters, and how exact they are."""
    drawn = f"{posterior.ess:.0f} effective draws, R-hat {posterior.rhat:.4f}, seed {posterior.seed}"
    exact = f"means and intervals exact to {posterior.error:.1g} standard deviations"
    fit, found = posterior.fit, posterior.summary()
    tail = [f"{posterior.accuracy}: {drawn}", exact, *_counted(fit), *_open(found)]
    return _identified("Posterior", fit, posterior.result.value, found, tail)


def of_log(log: "Log") -> Brief:
    """Of a log: its columns and their ranges."""
    from sysid.logs.written import columns

    inputs = ("time", "drive", "frequency", "temperature", "force")
    held = [name for name in inputs if getattr(log, name) is not None]
    what = ", ".join(["amplitude" if log.amplitude_only else "Wd + j Wq", *held])
    read = f"kind={log.kind!r}, sampling={log.sampling!r}"
    head = f"Log({log.path or log.name!r}, {len(log)} rows of {what}; {read})"
    rows = tuple((name, f"{np.min(v):.6g}", f"{np.max(v):.6g}") for name, v in columns(log).items())
    return Brief(head, ("column", "from", "to"), rows, (*log.warnings, *log.notes), inline=True)


def of_scene(scene: Any) -> Brief:
    """Of a scene: its plant, inputs and effects."""
    effects = ", ".join(e.name for e in scene.effects) or "none"
    inputs = [(name, f"{np.min(p.values):.6g} to {np.max(p.values):.6g}") for name, p in scene.inputs.items()]
    plant = ", ".join(
        f"{n} {getattr(scene.plant, n):.6g}"
        for n in ("G", "tau", "f0")
        if getattr(scene.plant, n) is not None
    )
    rows = (("plant", plant), *inputs, ("effects", effects), ("fidelity", scene.fidelity))
    return Brief(
        f"Scene({scene.name!r}, {scene.kind}, {scene.rows} rows at {scene.rate:.6g} Hz)", ("", ""), rows
    )


def of_prediction(prediction: "Prediction") -> Brief:
    """Of a prediction: how it stands beside what was recorded."""
    log, unit = prediction.log, prediction.log.response_unit
    parts = {"W": np.real} if log.amplitude_only else {"Wd": np.real, "Wq": np.imag}

    def rms(values: np.ndarray) -> str:
        return f"{np.sqrt(np.mean(values**2)):.3g} {unit}"

    told = (prediction.residual, prediction.std, prediction.total_std)
    rows = tuple((name, *(rms(part(v)) for v in told)) for name, part in parts.items())
    names = ("rms", "recorded - predicted", "error of the model", "with the noise")
    return Brief(f"Prediction of {log.name}: {len(log)} rows, {prediction.kind}", names, rows, headed=True)


def of_comparison(found: "Comparison") -> Brief:
    """Of another description of the same logs."""
    said = "worse" if found.worse else "no worse"
    head = f"Comparison({found.description!r}: elpd {found.difference:+.3g} ± {found.error:.2g}, {said})"
    moves = tuple((name, f"{moved:+.2f}") for name, moved in found.moves.items())
    return Brief(head, ("parameter", "would move, in standard deviations"), moves, inline=True)


def of_change(change: "Change") -> Brief:
    """Of a change from one fit to another."""
    rows = []
    for name, d in change.parameters.items():
        (old, std, new, by), unit = measured(d.old, d.std, (d.new, d.change), d.unit)
        rows.append((name, old, new, f"{by} ± {std} {unit}", f"{d.sigmas:+.1f}"))
    left = [f"{name}: {why}" for name, why in change.left_out.items()]
    names = ("parameter", "old", "new", "change", "in standard deviations")
    return Brief(f"Change: {change}", names, tuple(rows), (*left, *change.notes), headed=True)


def of_circuit(circuit: "Circuit") -> Brief:
    """Of an equivalent circuit."""
    told = [(in_words(name), *row(p)) for name, p in circuit.parameters.items() if p.determined]
    place = f", {circuit.reference:g} ohm, {circuit.device}" if circuit.reference else ""
    return Brief(f"Circuit{place}", PARAMETERS, tuple(told), tuple(_open(circuit.parameters)))


def of_advice(advice: "Advice | Raised") -> Brief:
    """Of an experiment to record next."""
    return Brief(f"{type(advice).__name__}({advice})", inline=True)


def _identified(
    kind: str, fit: "Fit", result: str, found: "Mapping[str, Parameter]", tail: Sequence[str]
) -> Brief:
    """Of parameters, in the form of the screen."""
    from sysid.posterior.change import plate_of

    said = verdict(result, found, len(fit.logs), plate_of(fit))
    head, at, rows = f"{kind}: {said}", fit.reference_temperature, []
    for name, p in found.items():
        where = f" at {at:.4g} degC" if name == "f0" and p.determined and at is not None else ""
        cells = row(p) if p.determined else ("not determined", "", p.unit)
        rows.append((name + where, *cells))
    return Brief(head, PARAMETERS, tuple(rows), tuple(tail))


def _open(found: "Mapping[str, Parameter]") -> list[str]:
    """Why parameters are not determined."""
    return [f"{name}: {p.why}" for name, p in found.items() if not p.determined]


def _counted(fit: "Fit") -> list[str]:
    """How many warnings and notes there are, where there are any."""
    counts = [(len(fit.warnings), "warning"), (len(fit.notes), "note")]
    said = [f"{n} {what}{'s' * (n > 1)} (.{what}s)" for n, what in counts if n]
    return [" and ".join(said)] if said else []


def _cut(line: str) -> str:
    return line if len(line) <= WIDTH else f"{line[: WIDTH - 3]}..."


def _escaped(text: Any) -> str:
    return escape(clean(str(text)))
