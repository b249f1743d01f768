"""What the exported C did at the carrier before its law was written by hand, and does now:  python benchmarks/at_the_carrier.py

Writes at_the_carrier.md beside itself.
"""

import math
import sys
import tempfile
from datetime import date
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import controller
from controller.actuator import Adc

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import onboard  # noqa: E402

TAU = 5e-3 / math.log(20)
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
ASKED, LIMIT = 2.0, 160.0
AT, RUN, FAULT = 0.2, 4, 5
# Beside each: the generated code of 24 November 2026, on the same bench.
BEFORE = {
    "polarity": "3.20 um, 160 V, for 500 ms",
    "polarity 350": "7.00 um, 350 V, for 500 ms",
    "polarity adaptive": "6.92 um, 350 V, for 30 ms",
    "dead": "1.94 um, 160 V, for 5 ms",
    "flip": "3.20 um to the end, no fault",
    "gain": "3.20 um to the end, no fault",
    "loop gain": "3.44 um, 124 V rms to the end, no fault",
    "clip": "3.20 um to the end, no fault",
    "nan": "0.00 um to the end, no fault",
    "overshoot": "0.9 % (0.0 % promised)",
    "small": "9 %",
    "margin": "4.5 to 4.75 (5.52 promised)",
    "adaptive margin": "2.0 to 2.1 (2.58 promised)",
    "start": "20.4 ms (1.7 ms promised)",
    "quiet": "dead after 8 ms",
    "held": "-18.96 Hz",
    "held 4": "-4.69 Hz",
}


def made(**given):
    """A loop of the plate, without a rig unless one is stated, and its bench."""
    loop = controller.design(PLATE, **({"voltage_limit": LIMIT} | given))
    return loop, onboard.closed_loop(loop, Path(tempfile.mkdtemp()))


def amplitude(rows):
    return np.hypot(rows.Wd, rows.Wq)


def driven(rows):
    """The largest amplitude and voltage, and for how long it drives."""
    on = rows.time[np.abs(rows.drive) > 1]
    until = on.max() - on.min() if len(on) else 0.0
    called = onboard.fault_name(rows.fault[-1])
    return f"{rows.peak.max():.2f} um, {rows.drive.max():.0f} V, for {1e3 * until:.0f} ms ({called})"


def after(rows):
    """What becomes of a loop that ran, from AT on."""
    late = rows[rows.time >= AT]
    if late["mode"][-1] != FAULT:
        return f"{amplitude(late)[-1]:.2f} um to the end, no fault"
    ended = late.time[np.argmax(late["mode"] == FAULT)] - AT
    return f"{late.peak.max():.2f} um, {onboard.fault_name(late.fault[-1])} after {1e3 * ended:.1f} ms"


def step(bench, low):
    """The overshoot of a step in run, over the step."""
    events = [(AT, "reference", low), (AT + 0.05, "reference", ASKED)]
    rows = bench.run(events, duration=AT + 0.09, reference=ASKED)
    late = amplitude(rows[rows.time > AT + 0.05])
    return 100 * (late.max() - ASKED) / (ASKED - low)


def margin(loop, bench):
    """Gains between which it begins to swing, and the promised one."""
    for gain in np.arange(1.5, 12, 0.1):
        events = [(AT, "G", PLATE.G * gain), (AT, "guard", 0.0), (AT + 0.1, "reference", 0.99 * ASKED)]
        rows = bench.run(events, duration=AT + 0.25)
        if np.ptp(amplitude(rows[-300:])) > 0.02 * ASKED:
            break
    return f"{gain - 0.1:.1f} to {gain:.1f} ({loop.promise.gain:.2f} promised)"


def started(bench):
    rows = bench.run(duration=AT)
    outside = np.flatnonzero(np.abs(amplitude(rows) - ASKED) > 0.05 * ASKED)
    return f"{1e3 * rows.time[outside[-1] + 1]:.1f} ms"


def beside(bench, **held):
    rows = bench.run(duration=0.4, **held)
    return f"{rows.made[-1000:].mean() - PLATE.f0:+.2f} Hz"


def rows():
    loop, pi = made()
    _, strong = made(voltage_limit=350.0, amplitude=ASKED)
    _, adaptive350 = made(voltage_limit=350.0, method="adaptive", amplitude=ASKED)
    adaptive_loop, adaptive = made(method="adaptive")
    _, counted = made(rig=controller.Rig(adc=Adc(12.0, 5.0, 16 * PLATE.f0)))
    wrong = {
        "flip": ("gain", -1.0),
        "gain": ("gain", 0.3),
        "loop gain": ("G", 5.2 * PLATE.G),
        "clip": ("clip", 1.0),
    }
    ends = {name: after(pi.run([(AT, *change)], duration=AT + 1)) for name, change in wrong.items()}
    nan = [(AT, "share", math.nan), (AT + 0.01, "share", 1.0)]
    quiet = counted.run([(AT, "reference", 0.0)], duration=AT + 0.2, noise=1e-5)
    return {
        "polarity": ("polarity wrong at switch-on", driven(pi.run(duration=0.8, gain=-1.0))),
        "polarity 350": ("the same, limit 350 V", driven(strong.run(duration=0.8, gain=-1.0))),
        "polarity adaptive": ("the same, adaptive", driven(adaptive350.run(duration=0.8, gain=-1.0))),
        "dead": ("no sensor at switch-on", driven(pi.run(duration=0.8, gain=0.0))),
        "flip": ("polarity flips in run", ends["flip"]),
        "gain": ("sensor's gain x 0.3 in run", ends["gain"]),
        "loop gain": ("loop gain x 5.2 in run", ends["loop gain"]),
        "clip": ("the sensor's front end clips at 1 um in run", ends["clip"]),
        "nan": ("share not a number for 10 ms", after(pi.run(nan, duration=AT + 0.2))),
        "overshoot": (
            "overshoot from rest, no rig",
            f"{step(pi, 0.0):.1f} % ({100 * loop.promise.overshoot:.1f} % promised)",
        ),
        "small": ("overshoot of a step of 10 %, of that step", f"{step(pi, 0.9 * ASKED):.0f} %"),
        "margin": ("gain at which it swings, no rig", margin(loop, pi)),
        "adaptive margin": ("the same, adaptive", margin(adaptive_loop, adaptive)),
        "start": ("from enable to within 5 %", started(pi)),
        "quiet": ("nothing asked for, quiet sensor", "no fault" if not quiet.fault.any() else after(quiet)),
        "held": ("drive held from sample to sample, beside the resonance", beside(pi, hold=4.0)),
        "held 4": ("the same, held for a quarter of one", beside(pi, hold=1.0)),
        "counted": ("held from sample to sample, and half of it counted", beside(pi, hold=4.0, counted=1.0)),
    }


def main() -> None:
    line = "\n".join(f"| {what} | {BEFORE.get(name, '-')} | {now} |" for name, (what, now) in rows().items())
    text = f"""# The exported C at the carrier

Made by `python benchmarks/at_the_carrier.py` on {date.today():%d %B %Y}. A plate of 0.02 um/V, {1e3 * TAU:.3g} ms and {PLATE.f0:g} Hz, {ASKED:g} um asked
for, {LIMIT:g} V at most unless said, the default method unless said, no rig; the bench of `tests/firmware/`. Before: the
generated code of 24 November 2026.

| what | before | now |
|---|---|---|
{line}
"""
    (HERE / "at_the_carrier.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
