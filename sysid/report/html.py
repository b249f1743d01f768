"""report.html: one file for an engineer to keep and to hand on; it asks for nothing else and holds no
program."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.report.text import (
    advice,
    cell,
    circuit_reasons,
    clean,
    derived,
    gains,
    gathered,
    grouped,
    in_words,
    measured,
    mode,
    moved,
    number,
    promised,
    row,
    seconds,
    sentence,
    shown,
    taken_for,
)

if TYPE_CHECKING:
    from sysid.logs.log import Log
    from sysid.posterior.posterior import Posterior
    from sysid.report.canvas import Drawn

SIEMENS = {"feedthrough": "S", "slope": "S/Hz"}  # of what the bench adds, in the units of an admittance
FEW = 20  # logs, up to which their table stands open
Cells = Sequence[Sequence[str]]


PLATE, LOOP, COST = "Logs, fit and plate", "Controller", "Accuracy"  # what figures show, as headings


def pictured(
    document: Mapping[str, Any], posterior: "Posterior", figures: "Sequence[Drawn] | None" = None
) -> "dict[str, Sequence[Drawn]]":
    """All figures of the report, below what they show. `figures`: those of the fit, where there are any
    already."""
    from sysid.report.canvas import drawn
    from sysid.report.costs import of_ladder
    from sysid.report.loopplots import of_loop
    from sysid.report.plots import fit_figures, of_posterior

    draws = drawn(of_posterior(posterior, document["parameters"]))
    return {
        PLATE: [*(figures or fit_figures(posterior.fit)), *draws],
        LOOP: drawn(of_loop(document["controller"], posterior.draws)),
        COST: drawn(of_ladder(document["uncertainty"]["rungs"])),
    }


def render(
    document: Mapping[str, Any],
    posterior: "Posterior",
    figures: "Mapping[str, Sequence[Drawn]] | None" = None,
    zoomable: str | None = None,
) -> str:
    """The report of fit.json's content (`document`) and of the posterior that it sums up. The same inputs,
    the same text. `figures`: what `pictured` gives, where it is there already; `zoomable`: the name of the
    file beside it that has them to zoom into."""
    figures, controller = figures or pictured(document, posterior), document["controller"]
    return template("template.html.j2").render(
        document,
        sentence=sentence(document, [fitted.log.metadata for fitted in posterior.fit.logs]),
        failed=document["result"] != "successful",
        remedy=advice(document["result"], len(document["logs"])),
        derived=derived(posterior.draws, document["parameters"]),
        shown=shown(document),
        circuit=document["derived"].get("circuit"),
        warned=gathered(document),
        noted=grouped(document),
        moved=moved(document["change"]) if document["change"] else [],
        figures=figures[PLATE],
        loops=figures[LOOP],
        costs=figures[COST],
        zoomable=zoomable,
        gains=gains(controller) if controller else [],
        promised=promised(controller) if controller else [],
        few=len(document["logs"]) <= FEW,
        tables={
            "logs": _logs(document["logs"]),
            "bench": _bench(document, posterior),
            "models": _models(document["models"]),
            "effects": _effects(document["findings"]),
            "correlation": _correlation(document["derived"].get("circuit")),
        },
    )


def _logs(logs: Sequence[Mapping[str, Any]]) -> Cells:
    """What each log was taken for, and how well it is described."""
    return [
        [
            f"{k}  {log['name']}",
            log["kind"],
            str(log["rows"]),
            taken_for(log),
            f"{number(log['nrmse_percent'], '.2f')} %",
            f"{number(log['noise_std'])} {log['response_unit']}"
            + (f", {log['noise']}" if log["noise"] != "white" else ""),
        ]
        for k, log in enumerate(logs, 1)
    ]


def _effects(findings: Sequence[Mapping[str, Any]]) -> Cells:
    """The numbers of the effects with which the logs are read, and what they gain."""
    rows = []
    for found in (f for f in findings if f["outcome"] == "fitted"):
        for name, x in found["numbers"].items():
            what = name.removesuffix(f"_{x['unit']}").replace("_", " ")
            (value, std), unit = measured(x["value"], x["std"] or 0.0, unit=x["unit"])
            said = f"{value} ± {std if x['std'] is not None else 'unknown'} {unit}"
            effect = found["key"].replace("_", " ")
            rows.append(
                [effect if what == effect else f"{effect}, {what}", said, ", ".join(found["logs"]) or "all"]
            )
            rows[-1].append(number(found["evidence"], ".3g"))
    return rows


def _bench(document: Mapping[str, Any], posterior: "Posterior") -> Cells:
    """What the bench added to each log, below the names of that; the noise and the start have no column of
    their own. Of an admittance the feedthrough is one, S at f0."""
    added = [log["parameters"] for log in document["logs"]]
    if document["derived"].get("circuit") and (f0 := document["parameters"]["f0"]["value"]):
        fitted = posterior.fit.logs
        added = [_in_siemens(own, f.log, f0) for own, f in zip(added, fitted, strict=True)]
    every = dict.fromkeys(name for own in added for name in own)
    names = [name for name in every if not name.startswith("noise") and not name.startswith("start")]
    rows = [[str(k), *(cell(own[n]) if n in own else "" for n in names)] for k, own in enumerate(added, 1)]
    return [["log", *(name.replace("_", " ") for name in names)], *(r for r in rows if any(r[1:]))]


def _in_siemens(own: Mapping[str, Any], log: "Log", f0: float) -> dict[str, Any]:
    """A log's own numbers, of which feedthrough (per unit of the drive) and its slope are admittances at f0
    (Hz)."""
    from sysid.posterior.circuit import per_drive  # what fits load, which no lot's page needs

    scale = per_drive(log)
    if scale is None:
        return dict(own)
    factor, told = scale[0] * (2 * np.pi * f0) ** scale[1], dict(own)
    for name, p in own.items():
        if p["determined"] and (kind := name.partition("_")[0]) in SIEMENS:
            value, std, (low, high) = (p[key] for key in ("value", "std", "ci95"))
            numbers = {"value": factor * value, "std": factor * std, "ci95": (factor * low, factor * high)}
            told[name] = p | numbers | {"unit": SIEMENS[kind]}
    return told


def _correlation(circuit: Mapping[str, Any] | None) -> Cells:
    """Correlation of the circuit's determined numbers, below their names."""
    if circuit is None:
        return []
    told = circuit["correlation"]
    kept = [k for k, name in enumerate(told["names"]) if name != "G_s"]  # which is 1/R1
    names = [in_words(told["names"][k]) for k in kept]
    rows = [
        [name, *(number(told["matrix"][k][m], ".2f") for m in kept)]
        for k, name in zip(kept, names, strict=True)
    ]
    return [["of", *names], *rows]


def _models(models: Mapping[str, Any] | None) -> Cells:
    """Other descriptions of the logs."""
    return [
        [
            other["description"],
            f"{number(other['elpd_difference'], '+.3g')} ± {number(other['elpd_error'])}",
            "worse" if other["worse"] else "no worse",
            ", ".join(f"{name} {number(by, '+.2f')}" for name, by in other["moves"].items()),
        ]
        for other in (models["compared"] if models else ())
    ]


def template(name: str) -> Any:
    """A page of this folder, of jinja2: nothing that a name or a sentence holds is markup."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        finalize=_finalize,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"plain": in_words, "circuit_reasons": circuit_reasons}
    environment.filters |= {"row": row, "mode": mode, "number": number, "seconds": seconds}
    return environment.get_template(name)


def _finalize(value: Any) -> Any:
    """Texts without control characters, which HTML forbids even when escaped."""
    return clean(value) if type(value) is str else value
