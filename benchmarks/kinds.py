"""Logs of the kinds that people bring, with known truth: what is said of them.  python benchmarks/kinds.py --seeds 7

Each kind is made in three variants or more, from closed forms that share no code with the package. An answer is

    right            successful, and every determined number within FAR of its standard deviations of the truth
    told             not successful, or no number that is further off is determined, and no cause is named that is not there
    wrong cause      a cause is named that is not there
    perhaps          the same, but of it is said that chance alone looks like this in one good fit of a hundred
    silently wrong   successful with a determined number further off

"No known effect explains it" names no cause. Where the program has no model of the kind, "told" is all that can be had.
Writes kinds.md beside itself.

    --seeds N   of each variant (default 7)        --only NAME   kinds whose name holds NAME; printed, not written
"""

import argparse
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

import numpy as np

from sysid import Log, fit

WHERE = Path(__file__).with_suffix(".md")
FAR = 4.0  # standard deviations: chance does it once in 16 000
CAUSES = {
    "saturation": "compressed|saturated",
    "second resonance": "a second resonance",
    "late": "begins late|s behind the inputs",
    "early": "before it should|s before the inputs",
    "too fast": "swept too fast",
    "drift": "drifts",
    "amplitude": "depends? on the amplitude",
    "noise": "noise hides|noise or background hide",
    "filter": "filter is stated; one of",
    "contradiction": "contradict",
    "immediate": "is there within a row",
    "restless": "restless",
    "no resonance": "no resonance is seen",
    "one reading": "one reading decides",
    "offset": "an offset of d and q",
    "feedthrough": "lies a feedthrough",
    "mirrored": "turns the other way",
    "overshoot": "of second order: it overshoots",
    "oscillation": "an oscillation itself",
}


@dataclass(frozen=True)
class Kind:
    """A kind: its variants by what they are called, each from a generator of random numbers; the truth of what they determine;
    the causes that are there."""

    variants: dict[str, Callable[[np.random.Generator], tuple[list[Log], dict[str, float]]]]
    causes: tuple[str, ...] = ()
    modelled: bool = field(default=True)


def noisy(rng, y, share):
    """With white noise of a share of the largest value, in each channel."""
    size = share * np.max(np.abs(y))
    return y + size * (
        rng.standard_normal(y.shape) + (1j * rng.standard_normal(y.shape) if np.iscomplexobj(y) else 0.0)
    )


def stepped(t, tau):
    return np.where(t > 0, -np.expm1(-np.maximum(t, 0) / tau), 0.0)


def step_log(t, y, drive=1.0, **more):
    volts = np.where(t < -1e-12, 0.0, drive)
    return Log("step", y, time=t, drive=volts, kind="transient", sampling="instant", **more)


def two_rates(fast, share):
    def made(rng):
        t = 5e-3 * (np.arange(220) - 20)
        y = 650 * (share * stepped(t, fast) + (1 - share) * stepped(t, 60e-3))
        return [step_log(t, noisy(rng, y, 0.02))], {}

    return made


def overshoot(zeta):
    def made(rng):
        w, t = 2 * np.pi * 170, 1e-4 * (np.arange(440) - 20)
        x, s = np.maximum(t, 0), np.sqrt(1 - zeta**2)
        y = np.where(
            t > 0, 1 - np.exp(-zeta * w * x) * (np.cos(s * w * x) + zeta / s * np.sin(s * w * x)), 0.0
        )
        return [step_log(t, noisy(rng, y, 0.005))], {}

    return made


def ring_down(off, offset):
    def made(rng):
        t, tau = 0.012 * np.arange(800), 1.5
        z = 20 * np.exp((-1 / tau + 2j * np.pi * off) * t) + offset * np.exp(1j)
        z = z + 0.1 * (rng.standard_normal(800) + 1j * rng.standard_normal(800))
        log = Log("ring", np.abs(z), time=t, frequency=np.full(800, 1000.0), kind="transient")
        return [log], {"tau": tau, "f0": 1000.0 + off}

    return made


F0, TAU = 32300.0, 1.669e-3


def settled(f, G=1.0, f0=F0, tau=TAU):
    return G / (1 + 2j * np.pi * (f - f0) * tau)


def sweep_log(f, y, **more):
    return Log("sweep", y, drive=np.ones(len(f)), frequency=f, **({"kind": "steady"} | more))


def wait_and_read(own, dwell, runs=False, back=False):
    """A sweep in which each point dwells for some tau; rows belong to their own inputs, or to those before; `runs`: a chirp."""

    def made(rng):
        f = F0 + np.linspace(-500, 500, 121)
        f = np.append(f, f[-2::-1]) if back else f
        fine, step = 32, dwell * TAU
        within = np.repeat(f, fine)
        if runs:  # from half a step before to half a step behind
            within = np.interp(np.arange(len(f) * fine) / fine - 0.5, np.arange(len(f)), f)
        z, rows = settled(within[0]), []
        for k, at in enumerate(within):
            pole = -1 / TAU + 2j * np.pi * (F0 - at)
            z = settled(at) + (z - settled(at)) * np.exp(pole * step / fine)
            if k % fine == (fine // 2 if runs else fine - 1):
                rows.append(z)
        if not own and not runs:
            rows, f = rows[:-1], f[1:]
        y = noisy(rng, np.exp(0.4j) * np.array(rows), 0.005)
        return [sweep_log(f, y, time=step * np.arange(len(f)), kind="transient")], {
            "tau": TAU,
            "f0": F0,
            "G": 1.0,
        }

    return made


def hurried(dwell):
    def made(rng):
        logs, truth = wait_and_read(True, dwell)(rng)
        return [sweep_log(logs[0].frequency, logs[0].response)], truth

    return made


def amplitude_feedthrough(share):
    def made(rng):
        f = F0 + np.linspace(-500, 500, 98)
        z = settled(f) + share * 1j
        return [sweep_log(f, np.abs(noisy(rng, z, 0.003)))], {"tau": TAU, "f0": F0}

    return made


def two_modes(apart, share):
    def made(rng):
        half = 1 / (2 * np.pi * TAU)
        f = F0 + half * np.linspace(-5, 4, 60)
        z = settled(f) + share * settled(f, f0=F0 + apart * half)
        return [sweep_log(f, np.abs(noisy(rng, z, 0.005)))], {"f0": F0, "tau": TAU}

    return made


def raw_oscillation(period):
    def made(rng):
        t = np.sort(rng.uniform(0, 4, 60))
        y = np.cos(2 * np.pi * t / period + rng.uniform(0, 2 * np.pi)) * np.exp(-t / 2.9)
        return [Log("raw", noisy(rng, y, 0.02), time=t, kind="transient")], {}

    return made


def low_pass(tau):
    def made(rng):
        f = np.geomspace(0.01, 10, 60) / tau / 2
        z = 0.28 / (1 + 2j * np.pi * f * tau)
        return [sweep_log(f, noisy(rng, z, 0.002))], {}

    return made


def small_drive(volts):
    def made(rng):
        f = F0 + np.linspace(-500, 500, 101)
        log = sweep_log(f, noisy(rng, settled(f), 0.01))
        return [Log("sweep", log.response, drive=np.full(101, volts), frequency=f, kind="steady")], {
            "G": 1 / volts,
            "tau": TAU,
        }

    return made


def late_sensor(late):
    def made(rng):
        t = 1e-5 * (np.arange(1200) - 100)
        beats = np.sqrt((2 * np.pi * F0) ** 2 - TAU**-2) - 2 * np.pi * (
            F0 - 8
        )  # damped, 0.14 Hz lower than f0
        z = settled(F0 - 8) * -np.expm1((-1 / TAU + 1j * beats) * np.maximum(t - late, 0))
        step = step_log(t, noisy(rng, z, 0.003), frequency=np.full(1200, F0 - 8))
        f = F0 + np.linspace(-500, 500, 101)
        return [step, sweep_log(f, noisy(rng, settled(f), 0.003))], {"G": 1.0, "tau": TAU, "f0": F0}

    return made


def k_T_untold(span):
    def made(rng):
        logs, f = [], F0 + np.linspace(-500, 500, 101)
        for k, warm in enumerate(np.linspace(24, 24 + span, 3)):
            y = noisy(rng, settled(f, f0=F0 - 8 * (warm - 24)), 0.01)
            told = np.full(101, np.round(2 * warm) / 2)
            more = {"temperature": told, "temperature_digit": 0.5, "kind": "steady"}
            logs.append(Log(f"s{k}", y, drive=np.ones(101), frequency=f, **more))
        return logs, {"G": 1.0, "tau": TAU}

    return made


def restless(swing):
    def made(rng):
        t, tau = 0.012 * np.arange(1200), 1.47
        wander = np.cumsum(rng.standard_normal(1200)) * swing
        on = t < 4.5

        poles, z = -1 / tau + 2j * np.pi * wander, np.zeros(1200, complex)
        for k in range(1199):  # held from row to row, so exactly
            rests = -float(on[k]) * 5000 / tau / poles[k]
            z[k + 1] = rests + (z[k] - rests) * np.exp(0.012 * poles[k])
        z = z + 3 * (rng.standard_normal(1200) + 1j * rng.standard_normal(1200))
        more = {"frequency": np.full(1200, 1.5e6), "kind": "transient", "sampling": "instant"}
        return [Log("restless", np.abs(z), time=t, drive=on.astype(float), **more)], {"tau": tau}

    return made


KINDS = {
    "half of the step settles at once": Kind(
        {"fast 1 ms": two_rates(1e-3, 0.5), "fast 2 ms": two_rates(2e-3, 0.4), "at once": two_rates(1e-5, 0.6)}, ("immediate",)),
    "a second-order step": Kind({f"zeta {z}": overshoot(z) for z in (0.05, 0.3, 0.6)}, ("overshoot",), False),
    "ring-down of amplitudes on an offset": Kind(
        {"below": ring_down(-0.3, 0.6), "above": ring_down(0.3, 0.6), "far": ring_down(0.8, 1.0)}, ("offset",)),
    "sweep, set, wait, read": Kind(
        {"own": wait_and_read(True, 2.5), "before": wait_and_read(False, 2.5), "own, slow": wait_and_read(True, 3.5),
         "own, back": wait_and_read(True, 1.5, back=True)}),
    "chirp": Kind({f"dwell {d} tau": wait_and_read(True, d, runs=True) for d in (0.5, 1.0, 2.0)}),
    "sweep too fast, without times": Kind({f"dwell {d} tau": hurried(d) for d in (0.4, 0.7, 1.0)}, ("too fast",)),
    "feedthrough under amplitudes": Kind({f"{s:.0%}": amplitude_feedthrough(s) for s in (0.02, 0.05, 0.1)}, ("feedthrough",)),
    "two modes, amplitudes": Kind(
        {"3 apart": two_modes(3.0, 0.7), "4 apart": two_modes(4.5, 0.9), "6 apart": two_modes(6.0, 0.5)}, ("second resonance",)),
    "an oscillation that was not demodulated": Kind(
        {f"period {p} s": raw_oscillation(p) for p in (0.3, 0.53, 0.9)}, ("oscillation",), False),
    "a low-pass": Kind({f"tau {t:g} s": low_pass(t) for t in (1e-4, 7e-4, 1e-2)}, ("no resonance",), False),
    "a drive of 1e-9 to 1e7 V": Kind({f"{v:g} V": small_drive(v) for v in (1e-9, 1e-7, 1e7)}),
    "a step that is late, beside a sweep": Kind({f"{t * 1e3:g} ms": late_sensor(t) for t in (0.1e-3, 0.3e-3, 0.5e-3)}, ("late", "filter")),
    "k_T not told": Kind({f"{s} degC": k_T_untold(s) for s in (0.5, 0.8, 1.0)}),
    "restless, then a decay": Kind({f"swing {s}": restless(s) for s in (0.02, 0.05, 0.1)}, ("restless",)),
}  # fmt: skip


def verdict(kind: Kind, logs: list[Log], truth: dict[str, float]) -> tuple[str, str]:
    """The answer's class, and what was said."""
    found = fit(logs)
    values = {n: p for n, p in found.parameters.items() if p.determined and n in truth}
    off = {n: abs(p.value - truth[n]) / p.std for n, p in values.items()}
    why = [p.why or "" for p in found.parameters.values()]
    said = " | ".join(
        [
            found.result.name,
            *(f"{n} {p.value:.8g} +- {p.std:.2g}" for n, p in values.items()),
            *found.warnings,
        ]
    )
    sure = [w for w in found.warnings if "perhaps: chance" not in w]
    named, hinted = (
        {name for name, words in CAUSES.items() if re.search(words, " ".join((*said_of, *why)))}
        for said_of in (sure, found.warnings)
    )
    if found.result.name == "successful" and (
        max(off.values(), default=0.0) > FAR or not (truth or kind.modelled)
    ):
        return "silently wrong", said
    if wrong := named - set(kind.causes):
        return "wrong cause", f"({', '.join(sorted(wrong))}) {said}"
    if wrong := hinted - set(kind.causes):
        return "perhaps", f"({', '.join(sorted(wrong))}) {said}"
    return ("right" if found.result.name == "successful" else "told"), said


def rows(kinds: dict[str, Kind], seeds: int) -> Iterator[str]:
    """A row of the table for each variant; what is wrong is printed in full."""
    for k, (name, kind) in enumerate(kinds.items()):
        for v, (variant, made) in enumerate(kind.variants.items()):
            answers = [verdict(kind, *made(np.random.default_rng([k, v, s]))) for s in range(seeds)]
            counts = Counter(a for a, _ in answers)
            for answer, said in answers:
                if answer in ("silently wrong", "wrong cause", "perhaps"):
                    print(f"{name}, {variant}: {answer}: {said}", flush=True)
            first = answers[0][1].replace("|", "/")[:160]
            cells = [str(counts[a]) for a in ("right", "told", "wrong cause", "perhaps", "silently wrong")]
            yield f"| {name} | {variant} | {' | '.join(cells)} | {first} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=7)
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    kinds = {name: kind for name, kind in KINDS.items() if given.only in name}
    table = [
        "# Logs of the kinds that people bring", "",
        f"Made by `python benchmarks/kinds.py --seeds {given.seeds}` on {date.today()}.", "", __doc__.partition("\n\n")[2].partition("Writes")[0],
        "| kind | variant | right | told | wrong cause | perhaps | silently wrong | the first answer |", "|---|---|---|---|---|---|---|---|",
        *rows(kinds, given.seeds), "",
    ]  # fmt: skip
    if given.only:
        print("\n".join(table))
    else:
        WHERE.write_text("\n".join(table), encoding="utf-8")


if __name__ == "__main__":
    main()
