"""Miswired benches and faults against the exported C, at the carrier:  python benchmarks/miswired.py

Writes miswired.md beside itself. `--only N ...` prints single benches.
"""

import argparse
import math
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

import controller
from controller.actuator import Adc

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import onboard  # noqa: E402

TAU = 5e-3 / math.log(20)
PLATE = SimpleNamespace(G=0.02, tau=TAU, f0=32300.0, k_T=-10.16)
ASKED = 1.8  # um
LIMIT, WINDOW = 250.0, (31900.0, 32700.0)
RATE = 16 * PLATE.f0
METHODS = ("pi", "paper", "pll", "adaptive")
AT, LAST = 0.3, 1.2  # s: of a fault in run; how long it is looked at
HIGH, OFF, SILENT = 1.5, 0.1, 0.2  # of what is asked: too much; wrong; s for which it may be wrong in run
STATED = 0.115  # s: the longest that a header states, `follow` and `model`, and until what was driven has died away
RUN, FAULT = 4, 5
# The generated code of 24 November 2026: peak and high (ms), at power-up and in run; silent.
BEFORE = {
    "polarity": (2.78, 497.3, 2.78, 1195.0, 6),
    "gains": (2.78, 1177.9, 3.34, 1195.0, 8),
    "rotation": (2.78, 497.2, 2.78, 1195.0, 2),
    "late": (2.78, 496.9, 2.78, 1195.0, 2),
    "clipped": (2.78, 507.6, 2.78, 1195.0, 4),
    "dropped": (1.89, 206.4, 2.78, 721.7, 4),
    "stuck": (0.96, 0.0, 2.69, 5.5, 0),
    "offset": (1.63, 1175.1, 1.8, 1195.0, 6),
    "told": (0.0, 0.0, 1.0, 0.0, 0),
    "other plate": (1.56, 0.3, 2.88, 9.2, 1),
    "weak drive": (1.0, 0.0, 1.0, 0.0, 5),
    "noisy": (1.08, 0.0, 2.51, 1148.9, 3),
    "all": (2.78, 1177.9, 3.34, 1195.0, 41),
}


class Case(NamedTuple):
    """One bench: a loop, what is wrong with it from `at` on, in words too."""

    method: str
    at: float
    kind: str
    words: str
    changes: dict[str, float]


class Outcome(NamedTuple):
    """`peak` over what was asked; `high`, s above HIGH of it; `silent`, s in run and OFF of it wrong, of
    any 2 SILENT; the modes and faults that it ends with, and s from the fault until the drive is off
    (nan: it is not)."""

    peak: float
    high: float
    silent: float
    mode: int
    fault: int
    ended: float
    ran: bool


def either(rng, *names):
    return names[rng.integers(len(names))]


def polarity(rng):
    return {either(rng, "gain", "amplifier"): -1.0}


def gains(rng):
    return {either(rng, "gain", "amplifier"): 10 ** rng.uniform(-1, 1)}


def rotation(rng):
    return {"rotation": rng.uniform(-180, 180)}


def late(rng):
    if rng.random() < 0.5:
        return {"latency": rng.uniform(1, 20) * 1e-4}
    return {"delay": 10 ** rng.uniform(-6, -3)}


def clipped(rng):
    return {"clip": ASKED * rng.uniform(0.2, 1.5)}


def dropped(rng):
    return {either(rng, "missing", "lost", "skipped"): rng.uniform(0, 1)}


def stuck(rng):
    return {either(rng, "stuck", "frozen"): 1.0}


def offset(rng):
    return {"offset": ASKED * rng.uniform(-2, 2)}


def told(rng):
    name = either(rng, "told_d", "told_q", "share", "reference")
    return {
        name: either(rng, math.nan, math.inf, -math.inf) if name != "told_q" else either(rng, math.nan, 0.0)
    }


def other_plate(rng):
    return {
        "f0": PLATE.f0 + rng.uniform(-600, 600),
        "tau": TAU * 5 ** rng.uniform(-1, 1),
        "G": PLATE.G * 5 ** rng.uniform(-1, 1),
    }


def weak_drive(rng):
    return (
        {"rail": LIMIT * rng.uniform(0.05, 0.8)}
        if rng.random() < 0.5
        else {"slew": 10 ** rng.uniform(5.5, 7.5)}
    )


def noisy(rng):
    return {"noise": ASKED * 10 ** rng.uniform(-1, 1)}


KINDS = (
    polarity,
    gains,
    rotation,
    late,
    clipped,
    dropped,
    stuck,
    offset,
    told,
    other_plate,
    weak_drive,
    noisy,
)


def drawn(number):
    """The bench of this number."""
    rng = np.random.default_rng([35, number])
    kind = KINDS[number % len(KINDS)]
    changes = kind(rng)
    words = ", ".join(f"{name} {value:.4g}" for name, value in changes.items())
    at = 0.0 if number // len(KINDS) % 2 == 0 else AT
    return Case(
        METHODS[number // (2 * len(KINDS)) % len(METHODS)],
        at,
        kind.__name__.replace("_", " "),
        words,
        changes,
    )


def benches():
    """By method, of the same rig: a converter of 12 bits, sampled 16 times in a period."""
    made = {}
    for method in METHODS:
        rig = controller.Rig(adc=Adc(12.0, 4.0, RATE))
        given = {"voltage_limit": LIMIT, "amplitude": ASKED, "frequency_window": WINDOW, "finger": 0.5}
        loop = controller.design(PLATE, method=method, rig=rig, **given)
        made[method] = onboard.closed_loop(
            loop, Path(tempfile.mkdtemp()), ticks=2.0, noise=0.01, reference=ASKED
        )
    return made


def played(bench, case):
    """The rows of a bench."""
    events = [(case.at, name, value) for name, value in case.changes.items()]
    return bench.run(events, duration=case.at + LAST)


def most_within(wrong, step, window):
    """The most that is wrong of any `window`, s: a limit cycle passes through what is right."""
    count = np.concatenate([[0], np.cumsum(wrong)])
    wide = min(round(window / step), len(wrong))
    return float(np.max(count[wide:] - count[:-wide])) * step


def outcome(case, rows):
    after = rows[rows.time >= case.at]
    step = np.median(np.diff(rows.time))
    W = np.hypot(after.Wd, after.Wq)
    wrong = (after["mode"] == RUN) & (np.abs(W / ASKED - 1) > OFF)
    off = np.flatnonzero(after["mode"] == FAULT)
    return Outcome(
        float(after.peak.max() / ASKED), float((after.peak > HIGH * ASKED).sum() * step), most_within(wrong, step, 2 * SILENT),
        int(rows["mode"][-1]), int(rows.fault[-1]), float(after.time[off[0]] - case.at) if len(off) else math.nan,
        bool((rows["mode"][rows.time < case.at] == RUN).any()),
    )  # fmt: skip


def sound(number):
    """A bench with nothing wrong: what is asked for in steps, a finger that comes and goes, warmth, noise
    of up to 3 %."""
    rng = np.random.default_rng([36, number])
    events, t = [], 0.2
    while t < 1.5:
        t += rng.uniform(0.005, 0.2)
        if rng.random() < 0.5:
            events.append((t, "reference", ASKED * rng.choice([0.0, rng.uniform(0.05, 1.0), 1.0])))
        else:  # pressed or lifted within 2 to 20 ms
            press, taken = rng.choice([0.0, rng.uniform(0, 0.5)]), rng.uniform(2e-3, 2e-2)
            before = next((v for _, n, v in reversed(events) if n == "finger"), 0.0)
            events += [
                (t + taken * x, "finger", before + (press - before) * x) for x in np.linspace(0.1, 1, 10)
            ]
            t += taken
    drift = rng.uniform(-15, 15)  # degC within 1.3 s, more than any plate does
    events += [(0.2 + 1.3 * x, "temperature", 24.0 + drift * x) for x in np.linspace(0, 1, 200)]
    # white noise of a sample: the demodulator leaves about a fifth of it
    return events, {
        "noise": ASKED * rng.uniform(0, 0.15),
        "k_T": PLATE.k_T,
        "f0": PLATE.f0 + rng.uniform(-30, 30),
        "seed": number,
    }


def sound_row(benches, method, count):
    peaks, faults = [], []
    for number in range(count):
        events, settings = sound(number)
        rows = benches[method].run(events, duration=1.8, **settings)
        peaks.append(rows.peak.max() / ASKED)
        faults.append(int(rows.fault[-1]))
    called = (
        ", ".join(f"{onboard.fault_name(f)} {faults.count(f)}" for f in sorted(set(faults) - {0})) or "none"
    )
    return f"| {method} | {count} | {called} | {max(peaks):.2f} |"


def row(name, found):
    """Of the benches of a kind; in brackets what was before."""
    calls = [onboard.fault_name(o.fault) for _, o in found if o.fault]
    said = (
        ", ".join(f"{n} {calls.count(n)}" for n in sorted(set(calls), key=lambda n: (-calls.count(n), n)))
        or "none"
    )
    halves = [[o for c, o in found if (c.at == 0) == power] for power in (True, False)]
    cells, before = [f"| {name} | {len(found)} | {said}"], BEFORE[name]
    for half, peak, high in zip(halves, before[0:3:2], before[1:4:2], strict=True):
        cells.append(f"{max((o.peak for o in half), default=0):.2f} ({peak:.2f})")
        cells.append(f"{1e3 * max((o.high for o in half), default=0):.0f} ({high:.0f})")
    return " | ".join([*cells, f"{sum(o.silent > SILENT for _, o in found)} ({before[4]}) |"])


def wrong(case, done):
    """What a bench shows that it should not."""
    power = case.at == 0 and done.peak > HIGH
    return power or done.high > STATED or done.silent > SILENT


def listed(number, case, done):
    when = "power-up" if case.at == 0 else "in run"
    ends = "run" if done.mode == RUN else onboard.fault_name(done.fault)
    until = "never" if math.isnan(done.ended) else f"{1e3 * done.ended:.1f}"
    times = f"{done.peak:.2f} | {1e3 * done.high:.1f} | {1e3 * done.silent:.0f}"
    return f"| {number} | {case.method} | {when} | {case.kind}: {case.words} | {times} | {ends} | {until} |"


def played_all(benches, cases):
    """(number, case, outcome) of each."""
    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(lambda c: outcome(c[1], played(benches[c[1].method], c[1])), cases))
    return [(number, case, end) for (number, case), end in zip(cases, done, strict=True)]


TEXT = """# Miswired benches

Made by `python benchmarks/miswired.py --benches {benches} --sound {sound}` on {day}. The exported C in single precision runs on a
bench at the carrier (`tests/firmware/`): plate of 0.02 um/V, 1.67 ms and 32300 Hz, ADC of 12 bits with 16 samples in a
period and noise of 5 LSB; {asked:g} um asked for, {limit:g} V at most, designed for a finger of 0.5, by each of the four
methods in turn. At power-up, or after {at:g} s, something goes wrong; it is looked at for {last:g} s more. Amplitudes are the
plate's own, over what is asked for.

Peak: the largest amplitude. High: the longest time above {high:g} times. Silent: benches in mode run with an amplitude more
than {off:.0f} % off for more than {silent:g} s of any {window:g} s. In brackets: the generated code of 24 November 2026.

| what is wrong | benches | faults called | peak, power-up | high (ms) | peak, in run | high (ms) | silent |
|---|---|---|---|---|---|---|---|
{rows}

Above {high:g} times at power-up: {power}. In run above {high:g} times for longer than the {stated:.0f} ms that the header states: {long}.
Silent: {quiet}. These are:

| number | method | when | what | peak | high (ms) | silent (ms) | ends in | drive off after (ms) |
|---|---|---|---|---|---|---|---|---|
{listed}

What is left is a sensor that shows too little while a finger is allowed for, by its gain or as its front end clips. The loop holds
what is shown. A sensor of gain g on the free plate and a sound one on a plate whose damping is 1/g times as large show the same
response to the same voltage, W = g G V = G V / (1 + finger), at the same resonance: in rest nothing tells them apart. (A frequency
that is moved on purpose would: Wq answers by tau, whatever the sensor's gain. No method does that.) Up to the finger of the design,
and in run up to one of 1.5, this is taken for a finger; the plate's header states both bounds.

## Sound benches

Steps of what is asked for, a finger of up to 0.5 that comes and goes, 15 degC in 1.3 s, white noise of the samples of up to
15 %: no fault should be called.

| method | benches | faults called | peak |
|---|---|---|---|
{sound_rows}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--benches", type=int, default=200)
    parser.add_argument("--sound", type=int, default=50)
    parser.add_argument("--only", type=int, nargs="+")
    given = parser.parse_args()
    made = benches()
    found = played_all(made, [(number, drawn(number)) for number in given.only or range(given.benches)])
    if given.only:
        print("\n".join(listed(*one) for one in found))
        return
    kinds = [k.__name__.replace("_", " ") for k in KINDS]
    rows = [row(k, [(c, o) for _, c, o in found if c.kind == k]) for k in kinds]
    text = TEXT.format(
        day=f"{date.today():%d %B %Y}", benches=given.benches, sound=given.sound, asked=ASKED, limit=LIMIT, at=AT, last=LAST, high=HIGH, off=100 * OFF,
        silent=SILENT, window=2 * SILENT, stated=1e3 * STATED,
        rows="\n".join([*rows, row("all", [(c, o) for _, c, o in found])]),
        power=sum(c.at == 0 and o.peak > HIGH for _, c, o in found),
        long=sum(c.at > 0 and o.high > STATED for _, c, o in found),
        quiet=sum(o.silent > SILENT for _, _, o in found),
        listed="\n".join(listed(*one) for one in found if wrong(*one[1:])),
        sound_rows="\n".join(sound_row(made, method, given.sound) for method in METHODS),
    )  # fmt: skip
    (HERE / "miswired.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
