"""Promises against the exported C at the carrier, for random plates, rigs and methods:  python
benchmarks/promise_carrier.py

Writes promise_carrier.md beside itself. `--only N ...` prints single cases."""

import argparse
import math
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

import controller
from controller.actuator import Adc
from controller.demodulator import IMAGE

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import onboard  # noqa: E402

METHODS = ("pi", "paper", "pll", "adaptive")
BAND = 0.05
RUN = 4
SMALL = 0.1  # of the amplitude, to which a small step goes
REGULATE, AMPLITUDE = 0.0, 1.0  # tasks: with and without the tracker
# of the amplitude, peak to peak: it oscillates. Near a margin the image, 0.1 %, is amplified to 3 %
SWINGS = 0.05
NEAR = 0.03  # relative, to which a margin is judged: near it the converter's noise rings for long; searched four times as near
WITHIN = 0.9  # of a promised margin, within which the loop with its tracker must not swing either
MOST = 40.0  # gain that is tried at most
RAMP = 40  # steps in which it is raised


class Case(NamedTuple):
    """A design, and the bench with one of the plates that it is promised for."""

    method: str
    words: str
    loop: Any
    bench: onboard.Bench


class Found(NamedTuple):
    """Times in s; overshoots, also of a `small` step, over the step; margins as factors and
    s, of the amplitude loop at resonance; whether the loop with its tracker does not swing within WITHIN
    of the promised ones."""

    started: float
    settling: float
    overshoot: float
    small: float
    gain: float
    delay: float
    tracks: bool


def extras(rng, T):
    """What some rigs have: a sensor of their own, an amplifier that cannot turn its voltage round, or one
    that changes it slowly."""
    more = {}
    if rng.random() < 0.3:
        more["sensor"] = controller.Sensor(
            rng.uniform(0.7, 1.3), rng.uniform(-90, 90), 10 ** rng.uniform(-7, -5)
        )
    if rng.random() < 0.2:
        more["bipolar"] = False
    if rng.random() < 0.2:
        more["voltage_slew"] = 100.0 / T / rng.uniform(1, 5)
    return more


def drawn(number, folder):
    """The case of this number; a ValueError where the design is refused."""
    rng = np.random.default_rng([37, number])
    method = METHODS[number % 4]
    f0 = math.exp(rng.uniform(math.log(20e3), math.log(60e3)))
    Q = math.exp(rng.uniform(math.log(30), math.log(600)))
    plate = SimpleNamespace(G=10 ** rng.uniform(-2, -1), tau=Q / (math.pi * f0), f0=f0, k_T=None)
    T = rng.choice([5e-5, 1e-4, 2e-4])
    latency, finger = T * rng.choice([0.5, 1.0, 1.0, 2.0]), rng.choice([0.0, 1.0])
    amplitude = plate.G * 100.0 / (1 + finger) / 1.25
    adc = (
        Adc(float(rng.choice([10, 12, 16])), 2.5 * amplitude, f0 * rng.uniform(4.2, 20))
        if rng.random() < 0.75
        else None
    )
    half = 3 / (2 * math.pi * plate.tau)
    more = extras(rng, T)
    given = {
        "sample_time": T,
        "latency": latency,
        "voltage_limit": 100.0,
        "amplitude": amplitude,
        "finger": finger,
    }
    given |= {"frequency_window": (f0 - half, f0 + half), "method": method}
    loop = controller.design(plate, rig=controller.Rig(adc=adc, **more), **given)
    touched = finger * rng.uniform(0, 1)
    rate = "none" if adc is None else f"{adc.bits:.0f} bits, {adc.rate / f0:.3g} f0"
    words = [
        f"f0 {f0:.0f} Hz",
        f"tau {1e3 * plate.tau:.3g} ms",
        f"T {1e6 * T:.0f} us",
        f"latency {1e6 * loop.latency:.0f} us",
    ]
    words += [f"ADC {rate}", f"finger {touched:.2g} of {finger:g}", *more]
    quiet = 0.0 if adc is None else 0.5 * adc.unit  # that the converter does not stand still at rest
    return Case(
        method,
        ", ".join(words),
        loop,
        onboard.closed_loop(loop, folder, finger=touched, ticks=4.0, noise=quiet),
    )


def started(case, **settings):
    """s until it runs, and the amplitude is what is asked."""
    rows = case.bench.run(**settings, duration=60 * case.loop.tau + 0.3)
    outside = np.flatnonzero((rows["mode"] != RUN) | (np.abs(size(rows) / case.loop.amplitude - 1) > BAND))
    last = int(outside[-1]) + 1
    return float(rows.time[last]) if last < len(rows) else math.nan


def size(rows):
    return np.hypot(rows.Wd, rows.Wq)


def step(case, at, part=1.0):
    """Settling (s) and overshoot over the step, of one from rest to `part` of the amplitude, in run."""
    loop, rest = case.loop, 20 * case.loop.tau + 40 * case.loop.sample_time
    asked = part * loop.amplitude
    rows = case.bench.run([(at, "reference", 0.0), (at + rest, "reference", asked)], duration=at + 2 * rest)
    after = rows[(rows.reference == asked) & (rows.time > at)]
    W = size(after) / asked
    outside = np.flatnonzero(np.abs(W - 1) > BAND)
    last = int(outside[-1]) + 1 if len(outside) else 0
    settled = float(after.time[last] - after.time[0]) if last < len(after) else math.inf
    return settled, float(max(after.peak[1:].max() / asked - 1, 0.0))  # the first is of before the step


def swings(case, at, changes, task=AMPLITUDE):
    """Peak to peak of the amplitude, over what is asked, long after a kick of 1 %; before it the changes come slowly."""
    long = 60 * case.loop.tau + 400 * case.loop.sample_time
    events = [(at, "guard", 0.0), (at + long, "reference", 0.99 * case.loop.amplitude)]
    for name, value in changes.items():
        steps = np.linspace(0, 1, RAMP + 1)[1:]
        first = case.bench.settings[name]
        events += [(at + 0.5 * long * x, name, first + (value - first) * x) for x in steps]
    rows = case.bench.run(events, duration=at + 3 * long, task=task)
    W = size(rows[-len(rows) // 8 :]) / case.loop.amplitude
    return float(np.ptp(W)) if rows["mode"][-1] == RUN else math.inf


def margin(case, at, change, most):
    """The largest x for which the loop does not oscillate under `change`(x), up to `most`."""
    enough = max(SWINGS, 3 * swings(case, at, {}))
    tried = np.linspace(0, most, 9)
    over = next((k for k, x in enumerate(tried) if k and swings(case, at, change(x)) > enough), None)
    if over is None:
        return math.inf
    low, high = tried[over - 1], tried[over]
    while high - low > NEAR / 4 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if swings(case, at, change(middle)) > enough else (middle, high)
    return (low + high) / 2


def found(case):
    begun, alone = started(case), started(case, task=AMPLITUDE)
    if math.isnan(begun) or math.isnan(alone):
        return Found(math.nan, *(math.nan,) * 5, False)
    loop, promised = case.loop, case.loop.promise
    rest = 20 * loop.tau
    settling, over = step(case, begun + rest)
    small = step(case, begun + rest, SMALL)[1]

    def stronger(x):
        return {"G": loop.G * 2**x}

    def later(x):
        return {"latency": loop.latency + x}

    gain = 2 ** margin(case, alone + rest, stronger, math.log2(MOST))
    delay = margin(case, alone + rest, later, 3 * max(promised.delay, loop.sample_time))
    changes = stronger(math.log2(max(WITHIN * min(promised.gain, MOST), 1.0))), later(WITHIN * promised.delay)
    enough = max(SWINGS, 3 * swings(case, begun + rest, {}, REGULATE))
    tracks = all(swings(case, begun + rest, change, REGULATE) <= enough for change in changes)
    return Found(begun, settling, over, small, gain, delay, tracks)


def noise(case, part=1.0):
    """Of `part` of the amplitude, what |W| may be off: the image at twice the carrier, which the loop makes
    1/2 + 1/disk times as large at most (|L / (1 + L)| = |1 - (1 - L) / (1 + L)| / 2); of `paper`, what is lost a
    step of its frequency beside the resonance, to second order; and four standard deviations of the converter's
    rounding and of the noise of half a unit, of whose variance the demodulator's filters, share s, leave
    2 s (2n - 2)! / (n - 1)!^2 / 2^(2n - 1), n = 4."""
    loop, adc = case.loop, case.loop.rig.adc
    known = IMAGE * (0.5 + 1 / loop.promise.disk)
    if case.method == "paper":
        known += (2 * math.pi * loop.tau * loop.law.tracker.size) ** 2 / 2
    if adc is None:
        return known
    left = 2 * loop.demodulator.share * math.comb(6, 3) / 2**7
    return known + 4 * adc.unit * math.sqrt((1 / 12 + 1 / 4) * left) / (part * loop.amplitude)


def broken(case, seen):
    """The promises that are."""
    p, given = case.loop.promise, case.bench.settings
    # a step of the bench begins with a tick
    later = case.loop.sample_time + 2 / (given["rate"] * given["ticks"])
    kept = {
        "start": not math.isnan(seen.started),
        "settling": not seen.settling > p.settling + later,
        "overshoot": not seen.overshoot > p.overshoot + noise(case),
        "small step": not seen.small > p.small + noise(case, SMALL),
        "gain": not seen.gain < p.gain * (1 - NEAR),
        "delay": not seen.delay < p.delay * (1 - NEAR),
    }
    return [name for name, ok in kept.items() if not ok]


def shown(number, case, seen):
    p = case.loop.promise
    return (
        f"| {number} | {case.method} | {case.words} | {1e3 * seen.settling:.2f} ({1e3 * p.settling:.2f}) | {100 * seen.overshoot:.1f} ({100 * p.overshoot:.1f}) "
        f"| {100 * seen.small:.1f} ({100 * p.small:.1f}) | {seen.gain:.2f} ({p.gain:.2f}) | {1e6 * seen.delay:.0f} ({1e6 * p.delay:.0f}) | {'no' if seen.tracks else 'yes'} | {', '.join(broken(case, seen)) or '-'} |"
    )


def summary(name, done):
    """Of cases that were designed."""
    if not done:
        return f"| {name} | 0 | | | | | | | |"
    p = [case.loop.promise for case, _ in done]
    late = max(s.settling / q.settling for (_, s), q in zip(done, p, strict=True))
    over = max(s.overshoot - q.overshoot for (_, s), q in zip(done, p, strict=True))
    small = max(s.small - q.small for (_, s), q in zip(done, p, strict=True))
    gain = min(s.gain / q.gain for (_, s), q in zip(done, p, strict=True))
    delay = min(s.delay / q.delay for (_, s), q in zip(done, p, strict=True))
    count = sum(bool(broken(case, seen)) for case, seen in done)
    return f"| {name} | {len(done)} | {late:.2f} | {100 * over:.1f} | {100 * small:.1f} | {gain:.2f} | {delay:.2f} | {sum(not s.tracks for _, s in done)} | {count} |"


def one(number):
    with tempfile.TemporaryDirectory() as folder:
        try:
            case = drawn(number, Path(folder))
        except ValueError as error:
            return number, None, str(error)
        return number, case, found(case)


HEAD = """\
| number | method | case | settling (ms) | overshoot (%) | small step (%) | gain margin | delay margin (us) | tracker swings | broken |
|---|---|---|---|---|---|---|---|---|---|"""
BEFORE = """\

Before, the generated code of 24 November 2026 on the same cases; small steps from 90 %, in all; margins with its tracker, where it swings by 2 %:

| method | cases | settling | overshoot (%) | small step (%) | gain margin | delay margin | broken |
|---|---|---|---|---|---|---|---|
| pi | 25 | 1.00 | 3.2 | 14 | 0.51 | 0.88 | 11 |
| paper | 25 | 1.00 | 2.0 | 10 | 0.34 | 0.12 | 15 |
| pll | 25 | 1.00 | 0.1 | 1 | 0.38 | 0.97 | 5 |
| adaptive | 24 | 1.05 | 14.5 | 14 | 0.46 | 0.77 | 17 |
"""


def report(done, refused, cases):
    """The page."""
    by = {method: [(c, s) for _, c, s in done if c.method == method] for method in METHODS}
    line, wrong = "\n", [shown(*d) for d in done if broken(d[1], d[2])]
    return f"""# Promises at the carrier

Made by `python benchmarks/promise_carrier.py --cases {cases}` on {date.today():%d %B %Y}. Random plates (20 to 60 kHz, quality 30 to 600), sample times, latencies,
converters, fingers and methods; the plate on the bench is one of those that the design is for. The exported C runs on a bench at
the carrier (`tests/firmware/`). Steps in run, from rest to the whole amplitude and to {100 * SMALL:.0f} % of it; margins: the plate's gain, or the latency, is raised
until the amplitude swings by {100 * SWINGS:.0f} % after a kick of 1 %, without guard or tracker. Tracker swings: cases in which the loop with its
tracker swings at {100 * WITHIN:.0f} % of a promised margin, which is one of the amplitude loop. {len(refused)} of {cases} designs were refused.

Worst of all cases: settling found over promised, overshoots found less promised, of the step, margins
found over promised. Broken: cases in which a promise is, by more than a sample, four standard deviations of the converter's noise in a
reading, the image at twice the carrier of which the demodulator leaves {100 * IMAGE:.1f} % and, of `paper`, what is lost a step of its
frequency beside the resonance, or {100 * NEAR:.0f} % of a margin.

| method | cases | settling | overshoot (%) | small step (%) | gain margin | delay margin | tracker swings | broken |
|---|---|---|---|---|---|---|---|---|
{line.join(summary(method, by[method]) for method in METHODS)}
{summary("all", [(c, s) for _, c, s in done])}
{BEFORE}
## Cases with a broken promise

{"Found, and in brackets promised." if wrong else "None."}

{line.join([HEAD, *wrong]) if wrong else ""}

Refused: {"; ".join(f"{n}: {why}" for n, why in refused) or "none"}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--only", type=int, nargs="+")
    given = parser.parse_args()
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(one, given.only or range(given.cases)))
    done = [(number, case, seen) for number, case, seen in results if case is not None]
    refused = [(number, why) for number, case, why in results if case is None]
    if given.only:
        print("\n".join([HEAD, *(shown(*one) for one in done)]))
        return
    text = report(done, refused, given.cases)
    (HERE / "promise_carrier.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
