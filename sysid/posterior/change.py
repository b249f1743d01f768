"""Whether a plate has changed from one fit to another: by how much each parameter, and how surely all
together.

    d = new - old        C = C_new + C_old        chi^2 = d^T C^-1 d

of the parameters that both determine, from logs that have none in common. Without a change chi^2 is above
what it is with probability p (that of k parameters). Errors are what the fits state: a bench that differs
by more than they hold, as another gain of its sensor, is a change of G here.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtr

from sysid.asked import refuse
from sysid.shown import Shown
from sysid.verdict.fitted import Fit

SURE = 0.01  # probability of a chi-square by chance, below which the plate counts as changed


@dataclass(frozen=True)
class Told:
    """What a fit tells of a plate: `values` (k,) of the determined parameters `names`, their `covariance`
    (k, k) and `units`; f0 at the temperature `at` (degC, None: none was recorded); the plate's name, and
    the hashes of the logs."""

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    units: tuple[str, ...]
    at: float | None
    plate: str | None
    logs: frozenset[str]

    @classmethod
    def of(cls, source: Any) -> "Told":
        """Of a fit, a posterior, the content of a fit.json, its path, or its folder's. Raises ValueError
        for what is none."""
        if isinstance(source, cls):
            return source
        if isinstance(source, str | Path):
            return cls._of_content(_read(Path(source)), str(source))
        if isinstance(source, Mapping):
            return cls._of_content(source, "the content")
        fit = source if isinstance(source, Fit) else getattr(source, "fit", None)
        if fit is None:
            refuse("fit", source, "a fit, a posterior, a fit.json or its folder")
        parameters = fit.parameters if source is fit else source.summary()
        names, matrix = covariance(fit, parameters)
        values, units = (
            zip(*((parameters[n].value, parameters[n].unit) for n in names), strict=True)
            if names
            else ((), ())
        )
        hashes = frozenset(f.log.sha256 for f in fit.logs if f.log.sha256)
        return cls(names, np.array(values), matrix, units, fit.reference_temperature, plate_of(fit), hashes)

    @classmethod
    def _of_content(cls, content: Mapping[str, Any], where: str) -> "Told":
        try:
            known = {name: p for name, p in content["parameters"].items() if p["determined"]}
            names = tuple(known)
            matrix = np.diag([float(p["std"]) ** 2 for p in known.values()])
            if (told := content.get("covariance")) and told["names"]:
                names, matrix = tuple(told["names"]), np.array(told["matrix"], float)
            values = np.array([float(known[name]["value"]) for name in names])
            units = tuple(known[name]["unit"] for name in names)
            hashes = frozenset(log["sha256"] for log in content["logs"] if log["sha256"])
            if matrix.shape != (len(names), len(names)) or not np.isfinite(matrix).all():
                raise ValueError("a covariance that is none")
            return cls(
                names,
                values,
                matrix,
                units,
                content["reference_temperature_degC"],
                content.get("plate"),
                hashes,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ValueError(
                f"{where}: found no fit ({error!r}), expected what identify or fit.save wrote"
            ) from None

    def only(self, names: Sequence[str]) -> "Told":
        """The same of some parameters."""
        index = [self.names.index(name) for name in names]
        units = tuple(self.units[k] for k in index)
        return replace(
            self,
            names=tuple(names),
            values=self.values[index],
            covariance=self.covariance[np.ix_(index, index)],
            units=units,
        )

    def carried(self, at: float) -> "Told":
        """The same with f0 at another temperature, by its own k_T."""
        carry, (f0, k_T) = np.eye(len(self.names)), (self.names.index(name) for name in ("f0", "k_T"))
        carry[f0, k_T] = at - self.at  # type: ignore[operator]
        return replace(self, values=carry @ self.values, covariance=carry @ self.covariance @ carry.T, at=at)


@dataclass(frozen=True)
class Difference:
    """Of one parameter: `change` = new - old, its standard deviation `std`, and the probability `p` of one
    as large by chance."""

    old: float
    new: float
    std: float
    unit: str

    @property
    def change(self) -> float:
        """New less old, in `unit`."""
        return self.new - self.old

    @property
    def sigmas(self) -> float:
        """The change in its standard deviations."""
        return self.change / self.std

    @property
    def p(self) -> float:
        """Probability that chance alone makes a change as large, of either sign."""
        return float(2 * ndtr(-abs(self.sigmas)))


@dataclass(frozen=True, repr=False)
class Change(Shown):
    """From an old fit to a new one: `parameters` that both determine, with what they changed by;
    `chi_square` of all together and its probability `p` by chance; why others are `left_out`; `notes` on
    what the comparison assumes."""

    parameters: dict[str, Difference]
    chi_square: float
    p: float
    left_out: dict[str, str]
    notes: tuple[str, ...] = ()

    @property
    def changed(self) -> bool:
        """Whether the plate has changed: by chance alone one in a hundred comparisons says so."""
        return self.p < SURE

    def __str__(self) -> str:
        count = len(self.parameters)
        if not count:
            return "the fits cannot be compared: they determine no parameter in common"
        of = f"chi-square {self.chi_square:.3g} of {count}, p = {self.p:.2g}"
        if not self.changed:
            return f"no change of the plate is seen ({of})"
        name, most = max(self.parameters.items(), key=lambda item: abs(item[1].sigmas))
        by = f"{name} by {most.change:+.3g} {most.unit}, {abs(most.sigmas):.2g} standard deviations"
        return f"the plate has changed ({of}): most of all {by}"

    def to_frame(self) -> Any:
        """A pandas DataFrame, a row for each parameter: old, new, change, std, sigmas, p, unit."""
        from sysid.report.frames import of_change

        return of_change(self)

    def _brief(self) -> Any:
        from sysid.report.brief import of_change

        return of_change(self)


def compare_fits(new: Any, old: Any) -> Change:
    """Whether the plate of `old` has changed in `new`, each a fit, a posterior, the content of a fit.json, or
    a path to one.

    f0 is compared at one temperature: where the fits' differ, by the k_T of one that determines it. Raises
    ValueError for what is no fit, and for units that differ.
    """
    told = [Told.of(new), Told.of(old)]
    left_out, notes = {}, []
    for name in dict.fromkeys((*told[0].names, *told[1].names)):
        missing = [which for which, t in zip(("new", "old"), told, strict=True) if name not in t.names]
        if missing:
            left_out[name] = f"the {missing[0]} fit does not determine it"
    if "f0" not in left_out and told[0].at != told[1].at:
        told, why = _at_one_temperature(*told)
        left_out |= {"f0": why} if why else {}
    names = [name for name in told[0].names if name not in left_out]
    a, b = (t.only(names) for t in told)
    if differing := [n for n, mine, theirs in zip(names, a.units, b.units, strict=True) if mine != theirs]:
        k = names.index(differing[0])
        raise ValueError(
            f"found {differing[0]} in {a.units[k]} and in {b.units[k]}, expected fits in the same units"
        )
    if a.logs & b.logs:
        notes.append("the fits share logs: what these tell does not count as a change, and p is too large")
    if a.plate and b.plate and a.plate != b.plate:
        notes.append(f"the fits are of two plates, {b.plate} and {a.plate}")
    chi_square, p, std = _joint(a, b)
    rows = zip(names, b.values.tolist(), a.values.tolist(), std.tolist(), a.units, strict=True)
    return Change(
        {n: Difference(x, y, s, unit) for n, x, y, s, unit in rows}, chi_square, p, left_out, tuple(notes)
    )


def covariance(fit: Fit, parameters: Mapping[str, Any]) -> tuple[tuple[str, ...], np.ndarray]:
    """The determined parameters and their covariance: the fit's correlations, with the standard deviations
    of `parameters`."""
    names = tuple(name for name in fit.names if parameters[name]["determined"])
    index = [fit.names.index(name) for name in names]
    found = fit.covariance[np.ix_(index, index)]
    size = np.array([parameters[name]["std"] for name in names]) / np.sqrt(np.diag(found))
    found = found * np.outer(size, size)
    return names, 0.5 * (found + found.T)


def plate_of(fit: Fit) -> str | None:
    """The plate that the logs name, which is one."""
    named = (item for fitted in fit.logs for item in fitted.log.metadata.items())
    return next((value for key, value in named if key.casefold() == "plate" and value), None)


def _joint(new: Told, old: Told) -> tuple[float, float, np.ndarray]:
    """Chi-square of all parameters, its probability by chance, and the standard deviation of each
    difference."""
    total = new.covariance + old.covariance
    std = np.sqrt(np.diag(total))
    z = (new.values - old.values) / std
    chi_square = float(z @ np.linalg.solve(total / np.outer(std, std), z)) if len(z) else 0.0
    return chi_square, float(chdtrc(len(z), chi_square)) if len(z) else 1.0, std


def _at_one_temperature(new: Told, old: Told) -> tuple[list[Told], str]:
    """Both at one temperature, or why f0 cannot be compared."""
    if new.at is None or old.at is None:
        return [new, old], "one of the fits says at no temperature where it holds"
    if "k_T" in new.names:
        return [new.carried(old.at), old], ""
    if "k_T" in old.names:
        return [new, old.carried(new.at)], ""
    return [
        new,
        old,
    ], f"it holds at {new.at:.4g} degC in one and {old.at:.4g} degC in the other, and neither determines k_T"


def _read(path: Path) -> Any:
    path = path / "fit.json" if path.is_dir() else path
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error}") from None
    except (ValueError, RecursionError):
        raise ValueError(
            f"{path}: found no JSON, expected a fit.json that identify or fit.save wrote"
        ) from None
