"""How fast the amplitude loop is to be: what was asked for, or the fastest that the delay and the posterior
allow.

One axis of the plate under a held voltage is  W[k+1] = alpha W[k] + G (1 - alpha) V[k],  alpha = exp(-Ts /
tau). The controller  C(z) = Kp (z - alpha) / (z - 1)  leaves  K / (z - p)  when nothing delays the voltage:

    p = exp(-2 pi bandwidth Ts),  K = 1 - p,  Kp = K / (G (1 - alpha)),  Ki Ts = K / G.

With d samples of delay the poles are the roots of z^d (z - 1) + K: real, so without oscillation, for K <= d^d
/ (d+1)^(d+1), which is 1/4 for one sample. The true K is that of a plate's own G/tau, which a finger leaves
alone and the posterior spreads: the limit holds for 99 % of it, so that a posterior that says little gives a
slower loop.
"""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from controller.adaptive import Adaptive
from controller.dq import DQ
from controller.laws import CEILING, FOLLOW_AFTER, FOLLOWS, SPARE, Asked
from controller.machine import NEAR, Machine
from controller.plate import positive
from controller.promise import LONGEST, samples, settling
from controller.tracker import SignTracker
from sysid.asked import number

# default tau_cl / tau, the paper's 0.5 ms for 1.67 ms: V peaks at 1/0.3 of its end value
CLOSED_LOOP_SHARE = 0.3
# The same where the delay is predicted: at a headroom of three in the voltage settling takes 8 % longer than
# at full voltage. The largest K there: with the observer's time constants of `laws`, a disk margin of two
# thirds on the paper's plate.
PREDICTED_SHARE, PREDICTED_K = 0.07, 0.52
OFFERED = 0.002  # to which, relatively, a refusal finds the nearest that can be had

Bound = Literal["stated", "plant", "delay", "posterior", "settling"]


class Bandwidth(NamedTuple):
    """Bandwidth of the closed loop, 1/(2 pi tau_cl), in Hz; the `limit` set by the delay; which `bound`
    decided; and whether the reference is fed forward."""

    hz: float
    limit: float
    bound: Bound
    lead: bool = False


def bandwidth_of(asked: Asked, wanted: float | None, settled: float | None) -> Bandwidth:
    """The stated bandwidth in Hz, or that of a settling time (5 %) in s, or the fastest possible. Raises
    ValueError for what cannot be had, with the limit in the way and the nearest that can."""
    if wanted is not None and settled is not None:
        raise ValueError("found bandwidth_hz and settling_time, expected one of them: each decides the other")
    _suited(asked)
    plate, T, limit = asked.plate, asked.T, _limit(asked)
    share = PREDICTED_SHARE if asked.method == "adaptive" else CLOSED_LOOP_SHARE
    plant = 1 / (2 * math.pi * share * plate.tau)
    safe = min(limit, -math.log1p(math.expm1(-2 * math.pi * limit * T) / plate.spread) / (2 * math.pi * T))
    if settled is not None:
        return _settled(asked, settled, safe, limit)
    if wanted is None:
        bound: Bound = "plant" if plant <= safe else "delay" if safe > 0.98 * limit else "posterior"
        return Bandwidth(min(plant, safe), limit, bound, asked.leads)
    if not number("bandwidth_hz", wanted) > 0:
        raise ValueError(
            f"bandwidth_hz = {wanted:g} cannot be had: any above 0 and up to {safe:.6g} Hz can; "
            f"the default is {min(plant, safe):.6g} Hz"
        )
    if wanted > safe * (1 + 1e-5):  # the six digits that the message below prints are accepted
        above = f"up to {100 * (plate.spread - 1):.2g} % above its mean"
        why = f" for 99 % of what the logs leave of G/tau ({above})" if plate.spread > 1.005 else ""
        raise ValueError(
            f"bandwidth_hz = {wanted:g} cannot be had: with a delay of {asked.delay:g} s the loop oscillates"
            f" above {safe:.6g} Hz{why}; the nearest that can be had is {safe:.6g} Hz"
        )
    return Bandwidth(min(float(wanted), safe), limit, "stated")


def _suited(asked: Asked) -> None:
    """Raises ValueError for a method that the plate, or the sample time, rules out."""
    longest = max(FOLLOW_AFTER, FOLLOWS * asked.plate.tau) / (SPARE + 2.0)
    if longest < asked.T:
        raise ValueError(
            f"sample_time = {asked.T:g} s cannot be had: of the plate, whose time constant is"
            f" {asked.plate.tau:.3g} s, the loop would see no fault in less than {SPARE + 2:g} samples; the"
            f" longest that can be had is {longest:.3g} s"
        )
    half_bandwidth, step = asked.plate.half_bandwidth, SignTracker(0.0, 1.0).size
    if asked.method == "paper" and asked.plate.f0 is not None and step > half_bandwidth:
        raise ValueError(
            f"method = 'paper' cannot be had: its frequency goes to and fro by {step:g} Hz, and half of the"
            f" plate's bandwidth is {half_bandwidth:.3g} Hz; methods that can be had: pi, pll, adaptive"
        )
    slowest = asked.plate.tau / (1 + asked.ranged.finger)
    if asked.method == "adaptive" and slowest * (1 + 1e-9) < asked.T:
        under = " under the finger" if asked.ranged.finger else ""
        raise ValueError(
            f"sample_time = {asked.T:g} s cannot be had with method = 'adaptive': its observer foresees no"
            f" more than one time constant{under}; the nearest that can be had is {slowest:.3g} s, or methods"
            " pi, pll"
        )


def _limit(asked: Asked) -> float:
    """Hz, of the largest K whose poles are real with the delay; where that is predicted, PREDICTED_K."""
    d, K = asked.delay / asked.T, PREDICTED_K
    if asked.method != "adaptive":
        K = math.exp(d * math.log(max(d, 1e-300)) - (d + 1) * math.log1p(d))  # d may be thousands
    # without delay every K has a real pole; 2 leaves 14 % of the error each sample
    return (-math.log1p(-K) if K < 1 else 2.0) / (2 * math.pi * asked.T)


def _settled(asked: Asked, wanted: float, fastest: float, limit: float) -> Bandwidth:
    """The lowest bandwidth whose promise settles within `wanted` s; where none does, the highest with
    feed-forward. Raises ValueError with the limit that stands in the way."""
    positive("settling_time", wanted)
    enough, tried = wanted * (1 + 1e-9), np.geomspace(fastest / 8, fastest, 10)
    # From the fastest: overshoot may make it settle later than a slower one.
    times = {b: _taken(asked, b) for b in tried[::-1]}
    if kept := [b for b, t in times.items() if t <= enough]:
        return Bandwidth(float(min(kept)), limit, "settling")
    led = _taken(asked, fastest, True) if asked.leads else math.inf
    if led <= enough:
        return Bandwidth(fastest, limit, "settling", True)
    best = min(led, *times.values())
    if math.isfinite(best):
        why = _too_little_voltage(asked, wanted) or _in_the_way(asked, tried, enough)
        why += f"; the nearest that can be had is {1e3 * best:.4g} ms"
    else:
        why = unkept(asked, fastest)
    raise ValueError(f"settling_time = {1e3 * wanted:g} ms cannot be had: {why}")


def _in_the_way(asked: Asked, tried: np.ndarray, enough: float) -> str:
    """That without which the loop would settle in `enough` s, in words: resonances that lie apart, a finger,
    or both; where it would not without them either, the sample time and the delay."""
    untouched = asked.over(asked.ranged._replace(finger=0.0)) if asked.ranged.finger else asked
    low, high = asked.ranged.warming
    apart = "what the logs leave open of f0"
    if (low, high) != (0.0, 0.0) and asked.plants.warming is None:
        apart = f"the range of temperatures, warming = ({low:g}, {high:g}),"
    found = f"the resonance begins up to {asked.beside:.3g} Hz beside the frequency at which the loop starts,"
    found += " and has to be found"
    finger = f"the finger, which adds {asked.ranged.finger:g} times the plate's own damping,"
    still, neither = (a._replace(plants=a.plants.resonant) for a in (asked, untouched))
    for without, why in (
        (still, f"{apart} stands in the way: {found}"),
        (untouched, f"{finger} stands in the way"),
        (neither, f"{finger} and {apart} stand in the way: {found}"),
    ):
        laws = ((b, lead) for b in tried for lead in {False, asked.leads})
        if without is not asked and any(_taken(without, *law) <= enough for law in laws):
            return why
    why = f"the sample time {asked.T:g} s and the delay {asked.delay:g} s stand in the way"
    return why + ("" if asked.leads else ": a faster loop oscillates")


def _taken(asked: Asked, bandwidth: float, lead: bool = False) -> float:
    return settling(asked.control(bandwidth, lead), asked.steps)


def _too_little_voltage(asked: Asked, wanted: float) -> str | None:
    """That the voltage limit stands in the way, where the slowest plant takes longer than wanted at full
    voltage: tau ln(r / (r - 0.95)) to 95 % of the amplitude, r = limit / steady voltage."""
    limit, plants = asked.limits.voltage, asked.plants
    if limit is None:
        return None
    r = limit * np.abs(plants.push) / plants.rate / abs(asked.amplitude)
    with np.errstate(divide="ignore"):
        bound = float(np.max(np.log(r / np.maximum(r - 0.95, 0.0)) / plants.rate))
    if bound <= wanted:
        return None
    return (
        f"the voltage limit {limit:g} stands in the way ({asked.limits.said}): at full voltage the slowest of"
        f" the plates takes {1e3 * bound:.3g} ms to 95 % of {asked.amplitude:g}"
    )


def unpromised(asked: Asked, law: DQ | Adaptive) -> str | None:
    """Why no settling time is promised, whatever the plants do: too many samples; None where they are not."""
    if (needed := samples(law, asked.plants, asked.T)) <= LONGEST:
        return None
    enough = 1.01 * asked.T * needed / LONGEST  # s; the samples are inversely as their time, but for a few
    return (
        f"no settling time is promised: plate and loop take so long that {needed} samples would have to be"
        f" looked at, and {LONGEST} are; a longer sample_time, {enough:.2g} s say"
    )


def unkept(asked: Asked, bandwidth: float, lead: bool = False) -> str:
    """Why more than 1 % of the plants do not settle at that bandwidth, and the nearest that can be had."""
    if long := unpromised(asked, asked.control(bandwidth, lead)):
        return long
    if _settles(asked, bandwidth, lead):
        return (
            "the guard ends the drive of more than 1 % of the plates that the logs allow, the resonance up to"
            f" {asked.beside:.4g} Hz beside the frequency at which the loop starts: what stays so small, or"
            " at the edge of its window, is taken for a fault; a narrower range, or guard=False, with which"
            " nothing is exported"
        )
    if hindered := _hindered(asked, bandwidth, lead):
        return hindered
    still = asked._replace(plants=asked.plants.resonant)
    if _settles(still, bandwidth):
        return (
            f"the loop cannot lock: the resonance lies up to {asked.beside:.4g} Hz beside the frequency at"
            " which it starts, where the voltage that there is makes too small an amplitude to be tracked;"
            f" {_narrower(asked, bandwidth)}"
        )
    share = _nearest(lambda s: _settles(still._replace(amplitude=s * asked.amplitude), bandwidth))
    limit, offer = asked.limits, "none that is smaller settles either"
    if share:
        offer = f"the nearest that can be had is {share * asked.amplitude:.4g}"
    said = "" if limit.voltage is None else f", with the voltage limit {limit.voltage:g} ({limit.said})"
    return (
        f"amplitude = {asked.amplitude:g} cannot be had: more than 1 % of the plates that the logs allow do"
        f" not come within 5 % of it{said}; {offer}"
    )


def abrupt(asked: Asked, bandwidth: float, machine: Machine) -> str | None:
    """That the design's finger ends the drive where it comes or goes at once, and how slowly it may; None
    where it does not. What a PI leaves of a finger p goes with the time constant t of its loop: of p/(1 + p)
    with (1 + p) t as it comes, of p with t as it goes. The readings are late besides, and their mean; the
    plate takes a time constant to follow its finger. Where p grows by r a second it is off by r t: here by
    half of what it may be."""
    if asked.method == "adaptive" or asked.ranged.finger == 0.0:  # it learns the damping, ahead of its loop
        return None
    slow, p, late = 1 / (2 * math.pi * bandwidth), asked.ranged.finger, asked.delay
    low = (1 + p) * slow * math.log(max(p / (1 + p) / NEAR, 1.0)) + late + asked.T / machine.memory
    high = slow * math.log(max(p / (CEILING - 1), 1.0)) + late + asked.plate.tau
    if low <= machine.follows * asked.T and high <= asked.patience * asked.T:
        return None
    return (
        f"a finger of {p:g} that comes or goes at once ends the drive: the loop, of {bandwidth:.3g} Hz, makes"
        f" up for it so slowly that the amplitude is off for longer than the guard waits; one that takes"
        f" {2 * p * slow / NEAR:.2g} s to come, and to go, does not"
    )


def _settles(asked: Asked, bandwidth: float, lead: bool = False) -> bool:
    return math.isfinite(_taken(asked, bandwidth, lead))


def _narrower(asked: Asked, bandwidth: float) -> str:
    """The widest share of the temperatures with which the loop locks, or else what determines f0."""
    ranged, ends = asked.ranged, asked.ranged.warming

    def within(share: float) -> bool:
        """Whether it locks with that share."""
        warming = share * ends[0], share * ends[1]
        return _settles(asked.over(ranged._replace(warming=warming)), bandwidth)

    if asked.plants.warming is not None or ends == (0.0, 0.0) or not (share := _nearest(within)):
        return "record a sweep, which determines f0 better"
    return f"the nearest that can be had is warming = ({share * ends[0]:.3g}, {share * ends[1]:.3g})"


def _hindered(asked: Asked, bandwidth: float, lead: bool) -> str | None:
    """The part of the rig, if any, without which the plants would settle, and the nearest that can be had."""

    def settles(name: str, value: float | None) -> bool:
        """With another value of that part."""
        changed: dict[str, Any] = {name: value}
        return _settles(asked._replace(rig=asked.rig._replace(**changed)), bandwidth, lead)

    units = {"voltage_slew": "a second", "timer": "Hz", "frequency_step": "Hz"}
    stated = (name for name in units if getattr(asked.rig, name) is not None)
    if (name := next((name for name in stated if settles(name, None)), None)) is None:
        return None
    given = getattr(asked.rig, name)

    def eased(share: float) -> float:
        """A faster slew or clock, a finer step."""
        return given * max(share, 1e-6) ** (1 if name == "frequency_step" else -1)

    share = _nearest(lambda share: settles(name, eased(share)))
    return (
        f"{name} = {given:g} {units[name]} stands in the way: without it the plates settle; the nearest that"
        f" can be had is {eased(share):.4g} {units[name]}"
    )


def _nearest(can: Callable[[float], bool]) -> float:
    """The largest share, up to one, that can be had, by bisection; 0 where none was found."""
    low, high = 0.0, 1.0
    while high - low > OFFERED:
        middle = (low + high) / 2
        low, high = (middle, high) if can(middle) else (low, middle)
    return low
