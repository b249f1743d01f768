"""Measured logs of other people's instruments, fitted and set beside their reference answers; writes real_logs.md.

    python benchmarks/real_logs.py FOLDER

FOLDER holds the data, one folder per source as named below; they are not part of this project. Each is read through a
mapping file of tests/mappings. Reference answers are those that the source states, or that a fit made elsewhere gave.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import sysid

MAPPINGS = Path(__file__).parents[1] / "tests" / "mappings"


@dataclass(frozen=True)
class Case:
    """One set of logs: where it lies, how it is read, and the reference: (name, value, error or None)."""

    pattern: str
    mapping: str
    reference: tuple[str, float, float | None]
    source: str
    remark: str = ""


WIRES, REED, RINGS, HEATER = (
    "06_vibrating_wires_and_fork",
    "02_vibrating_reed_temperature",
    "12_membrane_ringdown_power",
    "13_sbhs_heater_step",
)
MICROWAVE, PZT = "05_microwave_notch_and_reflection", "10_pzt_bar_admittance"
CASES = (
    Case(f"{REED}/reed_temperature_sweeps.csv", "reed_temperature_window", ("k_T", -0.02662, 0.00078), "straight line through 11 complex fits"),
    Case(f"{REED}/reed_temperature_sweeps.csv", "reed_temperature_window", ("f(40 degC)", 143.7687, 0.0052), "straight line through 11 complex fits", "one Q for all sweeps here; the 11 fits let Q rise from 10.5 to 11.1 with the temperature"),
    Case(f"{REED}/reed_temperature_sweeps.csv", "reed_temperature_sweeps", ("misfit", 1, None), "interfering line at 125 Hz"),
    Case(f"{MICROWAVE}/S11.txt", "microwave_reflection", ("Q", 253271, 197), "circle fit of the source", "background: constant and slope here, a cable delay there"),
    Case(f"{MICROWAVE}/S21testdata.csv", "microwave_notch", ("Q", 93116, 87), "least squares with a cable delay", "background: a slope here, a delay there; a linear background gave 94700 there too"),
    Case(f"{WIRES}/mcta_1.csv", "wires", ("width", 1.53, 0.003), "source's Readme, as rounded"),
    Case(f"{WIRES}/mcta_2.csv", "wires", ("width", 6.06, 0.003), "source's Readme, as rounded"),
    Case(f"{WIRES}/mcta_3.csv", "wires", ("width", 12.1, 0.03), "source's Readme, as rounded"),
    Case(f"{WIRES}/mctf_1.csv", "fork", ("f0", 32135.5752, 0.46), "complex least squares"),
    Case(f"{WIRES}/w2ta_1.csv", "wires", ("Q", 64503, 2100), "complex least squares"),
    Case(f"{WIRES}/mcta_d1.csv", "wires", ("misfit", 1, None), "two resonances"),
    Case(f"{WIRES}/mcta_d2.csv", "wires", ("misfit", 1, None), "two resonances"),
    Case(f"{WIRES}/mcta_ov.csv", "wires", ("misfit", 1, None), "clipped"),
    Case(f"{PZT}/pzt_bar_admittance.csv", "pzt_admittance", ("Q", 87.92, 0.5), "complex least squares, linear background"),
    Case(f"{PZT}/pzt_bar_admittance.csv", "pzt_admittance", ("f0", 128157.9, 4.1), "complex least squares, linear background", "charge is fitted here (the current divided by omega), the current there: the same background is a slope in one and a curve in the other"),
    Case(f"{RINGS}/measID_2542_*", "ringdown_2542", ("tau", 31.459, None), "straight line in dB"),
    Case(f"{RINGS}/measID_722_*", "ringdown_722", ("tau", 2.29, None), "authors"),
    Case(f"{RINGS}/measID_3413_*", "ringdown_3413", ("tau", 0.47425, None), "straight line in dB"),
    Case(f"{RINGS}/measID_795_*", "ringdown_795", ("tau", 4.471, None), "straight line in dB"),
    Case(f"{RINGS}/measID_488_*", "ringdown_488", ("tau", 158.69, None), "straight line in dB"),
    Case(f"{RINGS}/measID_596_*", "ringdown_596", ("tau", 0.10507, None), "straight line in dB"),
    Case(f"{RINGS}/measID_1838_*", "ringdown_1838", ("tau", 46.436, None), "straight line in dB"),
    Case(f"{RINGS}/measID_962_*", "ringdown_962", ("misfit", 1, None), "falls in two stages"),
    Case(f"{HEATER}/step_data.csv", "heater_step_30_35", ("tau", 35.61, None), "course manual"),
    Case(f"{HEATER}/step_data.csv", "heater_step_30_35", ("G", 0.42015, None), "course manual", "the manual takes the plate as settled at its first sample; here its start and an offset are free"),
)  # fmt: skip


def answers(fit: sysid.Fit) -> dict[str, tuple[float, float]]:
    """Name -> (value, standard deviation) of what the references are stated in."""
    p, found = fit.parameters, {}
    for name in ("G", "tau", "f0", "k_T"):
        if p[name].determined:
            found[name] = (p[name].value, p[name].std)
    tau, std = fit.plant.tau, np.sqrt(fit.covariance[fit.names.index("tau"), fit.names.index("tau")])
    found["width"] = (1 / (np.pi * tau), std / (np.pi * tau**2))
    if fit.plant.f0 is not None:
        found["Q"] = (np.pi * fit.plant.f0 * tau, np.pi * fit.plant.f0 * std)
    if "k_T" in found:
        i, j = fit.names.index("f0"), fit.names.index("k_T")
        span, c = 40 - fit.reference_temperature, fit.covariance
        found["f(40 degC)"] = (
            p["f0"].value + span * p["k_T"].value,
            float(np.sqrt(c[i, i] + 2 * span * c[i, j] + span**2 * c[j, j])),
        )
    found["misfit"] = (float(fit.result is sysid.Result.misfit), 0.0)
    return found


def main(folder: str) -> None:
    """Fit every case and write the table."""
    rows, fits = [], {}
    for case in CASES:
        (path,) = Path(folder).glob(case.pattern)
        key = (path, case.mapping)
        if key not in fits:
            fits[key] = sysid.fit(sysid.read_logs([path], columns=MAPPINGS / f"{case.mapping}.toml"))
        name, value, error = case.reference
        mine, std = answers(fits[key]).get(name, (float("nan"), float("nan")))
        both = float(np.hypot(std, error or 0.0))
        away = "" if name == "misfit" or not both else f"{(mine - value) / both:+.1f}"
        stated = f"{value:.7g}" + (f" ± {error:.2g}" if error else "")
        found = "" if name == "misfit" else f"{mine:.7g} ± {std:.2g}"
        said = "".join(fits[key].warnings[-1:]).removeprefix(f"{path.name}: ")
        ended = fits[key].result.name
        wanted = "not a good fit" if name == "misfit" else stated
        row = (path.name, name, wanted, case.source, found, away, ended, said, case.remark)
        rows.append("| " + " | ".join(row) + " |")
        print(rows[-1], flush=True)
    head = "| log | | reference | whose | here | difference, in both errors | ends | says | assumption that differs |"
    head += "\n|---|---|---|---|---|---|---|---|---|"
    text = (
        "# Real logs beside their reference answers\n\nMade by `python benchmarks/real_logs.py FOLDER`.\n\n"
    )
    Path(__file__).with_suffix(".md").write_text(text + "\n".join([head, *rows]) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
