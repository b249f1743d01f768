"""Numbers and names in words: two digits of the error, readable units, nothing that a terminal would obey."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

PREFIXES = (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9))
SCALED = {  # by unit: those in which it is read, and how many of each it is
    "s": PREFIXES,
    "F": (("uF", 1e6), ("nF", 1e9), ("pF", 1e12), ("fF", 1e15)),
    "H": (("mH", 1e3), ("uH", 1e6), ("nH", 1e9)),
    "S": (("S", 1.0), ("mS", 1e3), ("uS", 1e6), ("nS", 1e9)),
    "C/V": (("uC/V", 1e6), ("nC/V", 1e9), ("pC/V", 1e12), ("fC/V", 1e15)),
}
PLAIN = {
    "G_s": "G at resonance",
    "tan_d": "tan d",
    "figure_of_merit": "figure of merit",
    "unloaded_Q": "unloaded Q",
}
PLAIN |= {"loaded_Q": "loaded Q"}  # names of a circuit's numbers in words
ADVICE = {
    "the fit did not converge": "add a sweep across the resonance",
    "the model does not describe the logs": "do what the warnings ask for, or leave out the logs that they"
    " name",
    "the logs do not determine tau or G": "the parameters say what to record",
    "the sampler stopped before it reached its criteria": "take the normal approximation, --accuracy quick,"
    " or record more rows",
}
SEVERAL = {
    "the fit did not converge": "fit the logs one by one to find the one that disagrees, or add a sweep"
}


def advice(result: str, logs: int) -> str:
    """What to do about a fit of so many logs that ended so; empty where that went well."""
    return (SEVERAL if logs > 1 else {}).get(result) or ADVICE.get(result, "")


def verdict(result: str, parameters: Mapping[str, Any], logs: int, plate: str | None = None) -> str:
    """One sentence on a fit of so many logs of a plate: what is determined and what is not, or how it ended
    and what to do."""
    if result != "successful":
        return f"{f'plate {plate}: ' if plate else ''}{result}: {advice(result, logs)}"
    known = [name for name, p in parameters.items() if p["determined"]]
    open_ = [name for name, p in parameters.items() if not p["determined"]]
    of = f" of plate {plate}" if plate else ""
    said = (
        f"{listed(known)}{of} {'is' if len(known) == 1 else 'are'} determined from {logs}"
        f" log{'s' * (logs > 1)}"
    )
    return f"{said}; {listed(open_)} {'is' if len(open_) == 1 else 'are'} not" if open_ else said


DATED = ("date", "recorded", "measured", "acquired", "datetime", "date/time", "time stamp", "timestamp")


def sentence(document: Mapping[str, Any], stated: Sequence[Mapping[str, str]]) -> str:
    """The verdict on fit.json's content with the plate, how many logs there are and from when, and what to do
    next; `stated`: what each log states above its rows."""
    result, plate, when = document["result"], document["plate"], recorded(stated)
    logs = f"{len(stated)} log{'s' * (len(stated) > 1)}{f' of {when}' if when else ''}"
    if result != "successful":
        return f"{f'plate {plate}, ' if plate else ''}{logs}: {result}: {advice(result, len(stated))}"
    said = verdict(result, document["parameters"], len(stated), plate)
    said = said.replace(f"{len(stated)} log{'s' * (len(stated) > 1)}", logs, 1) if when else said
    return f"{said}. Next: {_next(document)}"


def recorded(stated: Sequence[Mapping[str, str]]) -> str:
    """The day that logs state, or the first and the last of several; empty where none states any. Days that
    begin with the year alone have an order; others are shown as they are written."""
    days = list(
        dict.fromkeys(
            v.strip() for log in stated for key, v in log.items() if key.casefold() in DATED and v.strip()
        )
    )
    whole = sorted({day[:10] for day in days if re.match(r"\d{4}-\d\d-\d\d", day)})
    if whole and all(day[:10] in whole for day in days):
        return whole[0] + (f" to {whole[-1]}" if len(whole) > 1 else "")
    return days[0] if len(days) == 1 else ""


def _next(document: Mapping[str, Any]) -> str:
    """What to do after a fit that went well."""
    count, open_ = (
        len(document["warnings"]),
        [name for name, p in document["parameters"].items() if not p["determined"]],
    )
    steps = [f"read the {'warning' if count == 1 else f'{count} warnings'}"] if count else []
    if document["controller"]:
        steps.append("commission the controller")
    if open_:
        steps.append(f"record what {listed(open_)} ask{'s' * (len(open_) == 1)} for, if needed")
    return f"{', then '.join(steps) or 'use the values'}."


def listed(names: Sequence[str]) -> str:
    """Names in a row: a, b and c."""
    return " and ".join([*filter(None, [", ".join(names[:-1])]), *names[-1:]])


def clean(text: str) -> str:
    """The text with control, direction and undecodable characters as \\uXXXX: a file name cannot steer the
    terminal."""

    def shown(c: str) -> str:
        return (
            c
            if c.isprintable() or c == "\n"
            else f"\\u{ord(c):04x}"
            if c < "\U00010000"
            else f"\\U{ord(c):08x}"
        )

    return text if text.isprintable() else "".join(map(shown, text))  # an image is a million characters


def number(value: float | None, form: str = ".2g") -> str:
    """A number of fit.json, which is null where it was not finite."""
    return "unknown" if value is None else format(value, form)


def seconds(value: float) -> str:
    """A time to three digits."""
    unit, factor = prefixed(value)
    return f"{value * factor:.3g} {unit}"


def measured(value: float, std: float, others: Iterable[float] = (), unit: str = "") -> tuple[list[str], str]:
    """[value, std, *others] to two digits of the error, and their unit; a time, a capacitance and the
    like come with a prefix."""
    if unit in SCALED:
        unit, factor = prefixed(max(abs(value), std), unit)
        value, std, others = value * factor, std * factor, [x * factor for x in others]
    size = max(abs(value), std)
    exponent = 3 * math.floor(math.log10(size) / 3) if size > 0 and (size < 1e-3 or std >= 1e6) else 0
    place = int(f"{std:.1e}".partition("e")[2])  # of the error's first digit, once rounded: 0.0996 is 0.10
    digits = min(max(1 - place + exponent, 0), 15) if std > 0 else 6
    tail = f"e{exponent}" if exponent else ""
    return [f"{x / 10**exponent:.{digits}f}{tail}" for x in (value, std, *others)], unit


def row(parameter: Any) -> tuple[str, str, str]:
    """Value and error, 95 % interval, unit of a determined parameter, a `Parameter` or in the form of
    fit.json."""
    (value, std, low, high), unit = measured(
        parameter["value"], parameter["std"], parameter["ci95"], parameter["unit"]
    )
    return f"{value} ± {std}", f"{low} to {high}", unit


def cell(parameter: Mapping[str, Any]) -> str:
    """A parameter in the form of fit.json in a few characters."""
    if not parameter["determined"]:
        return "cannot tell"
    value, _, unit = row(parameter)
    return f"{value} {unit}"


def mode(found: Mapping[str, float | None]) -> str:
    """One of the separate values of a parameter that has several."""
    return f"{number(found['value'], '.8g')} ± {number(found['std'])} (weight {number(found['weight'])})"


def derived(
    draws: Mapping[str, np.ndarray], parameters: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Q = pi f0 tau and half the bandwidth 1/(2 pi tau) from the draws, where their parameters are
    determined."""
    found = {}
    if parameters["tau"]["determined"]:
        if parameters["f0"]["determined"]:
            found["Q"] = _summarised(np.pi * draws["f0"] * draws["tau"], "1")
        found["half bandwidth"] = _summarised(1 / (2 * np.pi * draws["tau"]), "Hz")
    return found


def shown(document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """The parameters of fit.json by the names under which they are shown: where the logs have an equivalent
    circuit, its conductance at resonance stands for G, which is a charge per volt or as its log has it."""
    circuit, told = document["derived"].get("circuit"), {}
    for name, p in document["parameters"].items():
        if name == "G" and circuit is not None:
            conductance = circuit["parameters"]["G_s"]
            told[in_words("G_s")] = conductance if p["determined"] else p | {"unit": conductance["unit"]}
        else:
            told[name] = p
    return told


def in_words(name: str) -> str:
    """The name of one of a circuit's numbers, as it is read."""
    return PLAIN.get(name, name)


def circuit_rows(circuit: Mapping[str, Any]) -> dict[str, tuple[str, str, str]]:
    """Of the numbers of fit.json's circuit, by their names in words: value and error, 95 % interval, unit."""
    return {
        in_words(name): row(p) if p["determined"] else ("not determined", "", "")
        for name, p in circuit["parameters"].items()
        if name != "G_s"  # which stands among the parameters
    }


def circuit_reasons(circuit: Mapping[str, Any]) -> list[str]:
    """Why numbers of fit.json's circuit are not determined, each reason once."""
    names: dict[str, list[str]] = {}
    for name, p in circuit["parameters"].items():
        if not p["determined"] and name != "G_s":
            names.setdefault(p["why"], []).append(in_words(name))
    return [f"{listed(of)}: {why}" for why, of in names.items()]


def taken_for(log: Mapping[str, Any]) -> str:
    """The description of a log without its kind, which stands beside it."""
    return log["description"].removeprefix("transient").removeprefix("settled points").removeprefix(", ")


def grouped(document: Mapping[str, Any]) -> list[str]:
    """The notes of the fit, and those of the logs, each once, with the logs that it is about."""
    names: dict[str, list[str]] = {}
    for log in document["logs"]:
        for note in log["notes"]:
            names.setdefault(note, []).append(log["name"])
    return [*document["notes"]] + [
        f"{who[0] if len(who) == 1 else f'{len(who)} logs'}: {note}" for note, who in names.items()
    ]


def gathered(document: Mapping[str, Any]) -> list[str]:
    """The warnings, each once, with how many logs it is about where these are several."""
    names = sorted((log["name"] for log in document["logs"]), key=len, reverse=True)
    about: dict[str, list[str]] = {}
    for line in document["warnings"]:
        name = next((n for n in names if line.startswith(f"{n}: ")), None)
        about.setdefault(line if name is None else line.removeprefix(f"{name}: "), []).append(name or "")
    return [said if who == [""] else f"{_of_logs(who)}: {said}" for said, who in about.items()]


def _of_logs(names: Sequence[str]) -> str:
    """Logs by name, of many the first two."""
    few = listed(names) if len(names) <= 3 else f"{', '.join(names[:2])} and {len(names) - 2} more"
    return names[0] if len(names) == 1 else f"{len(names)} logs ({few})"


BOUNDS = {  # of the bandwidth, as `controller.bandwidth` names them
    "stated": "as stated",
    "settling": "for the settling time that was asked for",
    "plant": "tau_cl = 0.3 tau",
    "delay": "limited by the delay",
    "posterior": "limited by the uncertainty of G/tau",
}


def _steps(tracker: Mapping[str, float]) -> str:
    """What a tracker does at an update; an observer's goes where it sees the resonance."""
    if "step_Hz" in tracker:
        return f"{tracker['step_Hz']:.4g} Hz up or down, by the sign of Wq,"
    if "gain_Hz" not in tracker:
        return "to the resonance that the observer estimates,"
    return f"{tracker['gain_Hz']:.4g} Hz per Wq/Wd, at most {tracker['max_step_Hz']:.4g} Hz at once,"


def gains(controller: Mapping[str, Any]) -> list[str]:
    """The controller in a few lines."""
    unit, found = " ({drive} per {response})".format(**controller["units"]), controller["gains"]
    law = f"K {found['K']:.6g}, T/tau {found['damping']:.6g}" if "K" in found else (
        f"Kp {found['d']['Kp']:.6g}, Ki Ts {found['d']['Ki_Ts']:.6g}{unit}"
    )  # fmt: skip
    lines = [
        f"{law} at a sample time of {seconds(controller['sample_time_s'])}; closed loop"
        f" {controller['bandwidth_Hz']:.4g} Hz ({BOUNDS[controller['bandwidth_bound']]})"
    ]
    if tracker := controller["tracker"]:
        lines.append(
            f"tracker {_steps(tracker)} every {seconds(tracker['period_s'])}, from"
            f" {tracker['start_Hz']:.8g} Hz"
        )
    return [*lines, *_promise(controller), *controller["notes"]]


def moved(change: Mapping[str, Any]) -> list[str]:
    """By how much each parameter is away from an older fit's, and what the comparison leaves out and
    assumes."""
    lines = []
    for name, d in change["parameters"].items():
        (by, std), unit = measured(d["change"], d["std"], unit=d["unit"])
        lines.append(
            f"{name} {'' if by.startswith('-') else '+'}{by} ± {std} {unit} ({d['sigmas']:+.1f} standard"
            f" deviations)"
        )
    lines += [f"{name} is left out: {why}" for name, why in change["left_out"].items()]
    return [*lines, *change["notes"]]


def span(value: float) -> str:
    """A length of time (s) to two digits."""
    return (
        f"{value:.2g} s"
        if value < 99.5
        else f"{value / 60:.2g} min"
        if value < 5970
        else f"{value / 3600:.2g} h"
    )


def exactness(cost: Mapping[str, Any]) -> str:
    """What a run took, how exact its numbers are, in standard deviations, and what more would take: one
    line."""
    parts = [f"{cost['total_s']:.2g}" + (" s" if cost["budget_s"] is None else f" of {cost['budget_s']:g} s")]
    error = next((row["error"] for row in cost["stages"] if row["stage"] == "sample"), None)
    if error is not None and math.isfinite(error):
        parts.append(f"exact to {error:.1g} std")
    if more := cost["next"]:
        parts.append(f"--accuracy {more['accuracy']} would take {span(more['seconds'])} more")
    return "; ".join(parts)


def _promise(controller: Mapping[str, Any]) -> list[str]:
    """What 99 % of the plants that the logs allow do."""
    promise, unit = controller["promise"], controller["units"]["response"] or ""
    started = promise.get("startup_s")
    margins = ", ".join(
        f"{name} {promise[key]:.3g}{unit}"
        for name, key, unit in (
            ("gain", "gain_margin", ""),
            ("phase", "phase_margin_deg", " deg"),
            ("disk", "disk_margin", ""),
        )
        if promise[key] is not None
    )
    if promise["settling_s"] is None:  # a note says why
        return [
            f"99 % of the plants that the logs allow have margins of at least: {margins};"
            f" {_covered(controller)}"
        ]
    return [
        f"99 % of the plants that the logs allow reach {controller['range']['amplitude']:.4g} {unit} within"
        f" {seconds(promise['settling_s'])} (5 %), with margins of at least: {margins};"
        f" {_covered(controller)}",
        *([] if started is None else [f"switched on, they are there within {seconds(started)}"]),
    ]


def _covered(controller: Mapping[str, Any]) -> str:
    """The fingers and temperatures that a promise is for, in words."""
    finger, (low, high) = controller["range"]["finger"], controller["range"]["warming_degC"]
    at = controller["reference_temperature_degC"]
    touched = (
        f"under a finger that adds up to {finger:.3g} times the plate's damping"
        if finger
        else "without a finger"
    )
    if (low, high) == (0.0, 0.0):
        return f"{touched}, at {'the temperature of the logs' if at is None else f'{at:.4g} degC'}"
    return f"{touched}, at {at + low:.4g} to {at + high:.4g} degC"


def promised(controller: Mapping[str, Any]) -> list[list[str]]:
    """Of settling, overshoot and margins: a name, the 5, 50 and 95 % quantiles over the plants, and what 99 %
    of them keep."""
    times = [("settling to 5 %", "settling_s"), ("delay margin", "delay_margin_s")]
    plain = [
        ("overshoot", "overshoot"),
        ("overshoot of a step to a tenth, of that step", "small_overshoot"),
        ("gain margin", "gain_margin"),
        ("phase margin, degrees", "phase_margin_deg"),
    ]
    promise = controller["promise"]
    rows = []
    for name, key in [times[0], *plain, ("disk margin", "disk_margin"), times[1]]:
        values = [*promise["quantiles_5_50_95"][key], promise[key]]
        rows.append(
            [
                name,
                *("none" if v is None else seconds(v) if key.endswith("_s") else f"{v:.3g}" for v in values),
            ]
        )
    return rows


def prefixed(value: float, unit: str = "s") -> tuple[str, float]:
    """The unit with the prefix that suits a value, and the factor that takes the value to it."""
    known = SCALED[unit]
    return next((p for p in known if abs(value) * p[1] >= 1), known[0 if value == 0 else -1])


def _summarised(draws: np.ndarray, unit: str) -> dict[str, Any]:
    low, high = np.quantile(draws, [0.025, 0.975])
    return {
        "value": float(draws.mean()),
        "std": float(draws.std(ddof=1)),
        "ci95": [float(low), float(high)],
        "unit": unit,
    }
