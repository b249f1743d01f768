"""How fast the amplitude loop is to be: what was asked for, or the fastest that the delay and the posterior allow.

One axis of the plate under a held voltage is  W[k+1] = alpha W[k] + G (1 - alpha) V[k],  alpha = exp(-Ts / tau).
The controller  C(z) = Kp (z - alpha) / (z - 1)  leaves  K / (z - p)  when nothing delays the voltage:

    p = exp(-2 pi bandwidth Ts),  K = 1 - p,  Kp = K / (G (1 - alpha)),  Ki Ts = K / G.

With d samples of delay the poles are the roots of z^d (z - 1) + K: real, so without oscillation, for
K <= d^d / (d+1)^(d+1), which is 1/4 for one sample. The true K is that of a plate's own G/tau, which a finger leaves alone and
the posterior spreads: the limit holds for 99 % of it, so that a posterior that says little gives a slower loop.
"""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from controller.laws import Asked
from controller.plate import positive
from controller.promise import LONGEST, samples, settling

CLOSED_LOOP_SHARE = 0.3  # default tau_cl / tau, the paper's 0.5 ms for 1.67 ms: V peaks at 1/0.3 of its end value
# The same where the delay is predicted: at a headroom of three in the voltage settling takes 8 % longer than at full voltage.
# The largest K there: with the observer's time constants of `laws`, a disk margin of 0.75 on the paper's plate.
PREDICTED_SHARE, PREDICTED_K = 0.07, 0.52
OFFERED = 0.002  # to which, relatively, a refusal finds the nearest that can be had

Bound = Literal["stated", "plant", "delay", "posterior", "settling"]


class Bandwidth(NamedTuple):
    """The closed loop's, 1 / (2 pi tau_cl), in Hz; the `limit` that the delay sets; which `bound` decided; and whether the
    reference is fed forward."""

    hz: float
    limit: float
    bound: Bound
    lead: bool = False


def bandwidth_of(asked: Asked, wanted: float | None, settled: float | None) -> Bandwidth:
    """The bandwidth that is wanted, in Hz, or that of a settling time (5 %) in s, or the fastest. Raises ValueError for what
    cannot be had, with what stands in the way and the nearest that can."""
    if wanted is not None and settled is not None:
        raise ValueError("found bandwidth_hz and settling_time, expected one of them: each decides the other")
    plate, T, limit = asked.plate, asked.T, _limit(asked)
    share = PREDICTED_SHARE if asked.method == "adaptive" else CLOSED_LOOP_SHARE
    plant = 1 / (2 * math.pi * share * plate.tau)
    safe = min(limit, -math.log1p(math.expm1(-2 * math.pi * limit * T) / plate.spread) / (2 * math.pi * T))
    if settled is not None:
        return _settled(asked, settled, safe, limit)
    if wanted is None:
        bound: Bound = "plant" if plant <= safe else "delay" if safe > 0.98 * limit else "posterior"
        return Bandwidth(min(plant, safe), limit, bound, asked.leads)
    if not wanted > 0:
        raise ValueError(
            f"bandwidth_hz = {wanted:g} cannot be had: any above 0 and up to {safe:.6g} Hz can; "
            f"the default is {min(plant, safe):.6g} Hz"
        )
    if wanted > safe * (1 + 1e-5):  # the six digits that the message below prints are accepted
        why = f" for 99 % of what the logs leave of G/tau (up to {100 * (plate.spread - 1):.2g} % above its mean)"
        raise ValueError(
            f"bandwidth_hz = {wanted:g} cannot be had: with a delay of {asked.delay:g} s the loop oscillates above"
            f" {safe:.6g} Hz{why if plate.spread > 1.005 else ''}; the nearest that can be had is {safe:.6g} Hz"
        )
    return Bandwidth(min(float(wanted), safe), limit, "stated")


def _limit(asked: Asked) -> float:
    """Hz, of the largest K whose poles are real with the loop's delay; where the delay is predicted, PREDICTED_K less the share
    of it that is not."""
    samples = asked.delay / asked.T
    if asked.method == "adaptive":
        K = PREDICTED_K / (1 + samples - asked.latency / asked.T)
    else:
        K = samples**samples / (samples + 1) ** (samples + 1)
    # without delay every K has a real pole; 2 leaves 14 % of the error each sample
    return (-math.log1p(-K) if K < 1 else 2.0) / (2 * math.pi * asked.T)


def _settled(asked: Asked, wanted: float, fastest: float, limit: float) -> Bandwidth:
    """The lowest bandwidth whose promise settles within `wanted` s; where none does, the highest with feed-forward. Raises
    ValueError with the limit that stands in the way."""
    positive("settling_time", wanted)
    tried = np.geomspace(fastest / 8, fastest, 10)
    times = [_taken(asked, b) for b in tried[::-1]]  # from the fastest: overshoot may make it settle later than a slower one
    best = min(times)
    if best > wanted * (1 + 1e-9) and asked.leads:
        best = min(best, led := _taken(asked, fastest, True))
        if led <= wanted * (1 + 1e-9):
            return Bandwidth(fastest, limit, "settling", True)
    if not math.isfinite(best):
        raise ValueError(f"settling_time = {1e3 * wanted:g} ms cannot be had: {unkept(asked, fastest)}")
    if best > wanted * (1 + 1e-9):
        bound = _voltage_bound(asked)
        if bound > wanted:
            why = (
                f"the voltage limit {asked.limits.voltage:g} stands in the way ({asked.limits.said}): at full voltage the"
                f" slowest of the plates takes {1e3 * bound:.3g} ms to 95 % of {asked.amplitude:g}"
            )
        else:
            why = f"the sample time {asked.T:g} s and the delay {asked.delay:g} s stand in the way"
            why += "" if asked.leads else ": a faster loop oscillates"
        raise ValueError(
            f"settling_time = {1e3 * wanted:g} ms cannot be had: {why}; the nearest that can be had is {1e3 * best:.4g} ms"
        )
    slowest = next(b for b, t in zip(tried, times[::-1], strict=True) if t <= wanted * (1 + 1e-9))
    return Bandwidth(float(slowest), limit, "settling")


def _taken(asked: Asked, bandwidth: float, lead: bool = False) -> float:
    return settling(asked.control(bandwidth, lead), asked.plants, asked.T, asked.delay, asked.amplitude, asked.plate.f0)


def _voltage_bound(asked: Asked) -> float:
    """Time at full voltage to 95 % of the amplitude, of the slowest plant: tau ln(r / (r - 0.95)), r = limit / steady voltage."""
    if asked.limits.voltage is None:
        return 0.0
    plants = asked.plants
    r = asked.limits.voltage * np.abs(plants.push) / plants.rate / abs(asked.amplitude)
    short = r <= 0.95
    times = np.log(np.where(short, 2.0, r) / np.where(short, 1.0, r - 0.95)) / plants.rate
    return float(np.max(np.where(short, np.inf, times)))


def unkept(asked: Asked, bandwidth: float) -> str:
    """Why more than 1 % of the plants do not settle at that bandwidth, and the nearest that can be had."""
    if (needed := samples(asked.control(bandwidth), asked.plants, asked.T)) > LONGEST:
        return (
            f"no settling time is promised: {needed} samples would have to be looked at, and {LONGEST} are; a longer sample_time"
        )
    still = asked._replace(plants=asked.plants.resonant)
    if math.isfinite(_taken(still, bandwidth)):
        least, most = asked.ranged.warming

        def warmed(share: float) -> Asked:
            """With a share of the range of temperatures."""
            return asked.over((share * least, share * most))

        furthest = float(np.max(np.abs(asked.plants.detuning)))
        share = _nearest(lambda s: math.isfinite(_taken(warmed(s), bandwidth)))
        offer = "record a sweep, which determines f0 better"
        if share and least != most:
            offer = f"the nearest that can be had is warming = ({share * least:.3g}, {share * most:.3g})"
        return (
            f"the loop cannot lock: the resonance lies up to {furthest:.4g} Hz beside the frequency at which it starts, where the"
            f" voltage that there is makes too small an amplitude to be tracked; {offer}"
        )
    share = _nearest(lambda s: math.isfinite(_taken(still._replace(amplitude=s * asked.amplitude), bandwidth)))
    limit = "" if asked.limits.voltage is None else f", with the voltage limit {asked.limits.voltage:g} ({asked.limits.said})"
    offer = f"the nearest that can be had is {share * asked.amplitude:.4g}" if share else "none that is smaller settles either"
    return (
        f"amplitude = {asked.amplitude:g} cannot be had: more than 1 % of the plates that the logs allow do not come"
        f" within 5 % of it{limit}; {offer}"
    )


def _nearest(can: Callable[[float], bool]) -> float:
    """The largest share, up to one, that can be had, by bisection; 0 where none was found."""
    low, high = 0.0, 1.0
    while high - low > OFFERED:
        middle = (low + high) / 2
        low, high = (middle, high) if can(middle) else (low, middle)
    return low
