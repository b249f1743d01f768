"""The parts of a controller for a given bandwidth: law, tracker, guard, start-up machine, demodulator."""

import math
from typing import Any, NamedTuple

import numpy as np

from controller.adaptive import Adaptive
from controller.demodulator import Demodulator
from controller.dq import DQ
from controller.ensemble import Ensemble, Range
from controller.guard import Guard
from controller.limits import Limits
from controller.machine import ANY, Machine
from controller.pi import PI, Model
from controller.plate import Plate
from controller.promise import Clock, Promise, Steps, promise
from controller.rig import Calibrated, Method, Rig
from controller.scalar import NO_LIMIT
from controller.tracker import PLL, SignTracker, Tracker

BETA = 0.3  # share of the detuning that one tracker update removes
# of the sample time and the delay: the PLL's kp at most, a damped loop with one sample of delay
PLL_RATE = 0.1
FAULT_AFTER, STUCK_AFTER = 5e-3, 2e-2  # s, for which the guard looks on at least
# It looks on longer where the plate or the clock is slow. RESTS and ANSWERS, time constants: a plate that is
# braked has come to where it is held, and one whose voltage moves by 0.1 % of its limit shows 95 % of that.
# SPARE samples beyond twice the delay: before a delay is over a sound sensor shows nothing of what is driven,
# and after as long again 5 % of it.
RESTS, ANSWERS, SPARE = 2.0, 3.0, 4.0
# Tracker periods: of the means against which the guard sees how Wq answers the frequency, and for which it
# must be wrong. A resonance that jumps is chased within half of the latter (benchmarks/faults.md).
MEMORY, DOUBTS = 3.0, 5.0
# share of the amplitude to look with; time constants of a soft start; s until it is lost
BEGIN, RAMP, WAIT = 0.1, 10.0, 0.5
TRIES = 20.0  # times the samples for which it has to be near, until it is lost at the earliest
MEAN = 4.0  # times that the mean of readings follows them within the samples for which they have to be near
# Dead bands, of a step of the source: of a quiet estimate, and of one whose noise is half a Hz where W has
# one of 1 %. There and back is twice as far.
QUIET, LOUD = 0.1, 0.15
# s, time constants of the observer for the resonance, whose noise is heard, and for the damping
OBSERVER = 5e-4, 2e-4

# The amplitude may reach CEILING times what is asked: a heavy finger's release comes to 1.25. Until a loop
# runs its voltage is at most HEADROOM times what its plate needs: 1 + 1/RAMP to rise so fast, and room for
# noise, of which 5 % in find move the voltage by 0.1. So no wiring makes 1.5 times what is asked, but one
# that answers to little as another plate of the design does.
CEILING, HEADROOM = 1.35, 1.25
FITS = 0.1  # by which the voltage in lock may be off, as the amplitude may
HEAVY = 1.5  # damping, of the plate's own, that is taken for a finger in run, whatever range was designed for
# Of the amplitude, from one reading to the next: noise of 5 % in each of Wd and Wq moves one of them by 0.07.
# What a plate moves by itself is a heavy finger's damping, and as much of a resonance that lies beside.
ROOM = 0.15
# s, and time constants, for which a loop in run may be off, or at the end of its voltage
FOLLOW_AFTER, FOLLOWS = 0.1, 20.0
# Of its limit, the swing of a voltage that oscillates: a reading's noise of 5 % makes it move by 0.1 rms.
# SWINGS turns, of half a period of a loop at its margin, 2 d + 1 samples with d of delay; LONGER than that
# they are no oscillation.
SWING, SWINGS, LONGER = 0.3, 40.0, 2.0
# a sensor is not dead where less than so many of its units, or of the amplitude, is driven
QUIET_UNITS, QUIET_SHARE = 2.0, 1e-3
FEWEST = 4.0  # samples of the sensor in a step whose number is looked at
SWEEPS = 20.0  # time constants in which a sweep passes over half a bandwidth: settled
SENSIBLE = (-60.0, 200.0)  # degC, where neither a range nor a window is stated


class Asked(NamedTuple):
    """Everything that a controller is made from, except the bandwidth."""

    plate: Plate
    T: float
    latency: float
    limits: Limits
    rig: Rig
    method: Method
    plants: Ensemble
    amplitude: float
    ranged: Range

    @property
    def delay(self) -> float:
        """Seconds from a motion of the plate to the command that answers it."""
        return self.latency + self.rig.delay(self.plate.f0)

    def over(self, ranged: Range) -> "Asked":
        """The same over another range of temperatures and fingers."""
        return self._replace(plants=Ensemble.of(self.plate, ranged, self.rig.thermometer), ranged=ranged)

    @property
    def beside(self) -> float:
        """Hz, the furthest that a resonance lies beside the start of its loop, with a thermometer's news."""
        return float(np.max(np.abs(self.plants.unforeseen(self.plate.k_T))))

    @property
    def patience(self) -> float:
        """Samples for which the guard, and what switches the loop on, look on: at any sample time more than
        the delay and the plate's own rise take."""
        least = max(FAULT_AFTER, RESTS * self.plate.tau) / self.T
        return float(math.ceil(max(least, 2 * self.delay / self.T + SPARE)))

    @property
    def period(self) -> float:
        """Seconds between two updates of the proportional tracker.

        With q = Wq / Wd: q' = -q / tau + delta, delta' = -beta q / (period tau), damping sqrt(period / (4
        beta tau)). 1 ms gives the paper's plate 0.7; a plate that rings longer is updated less often, or its
        tracker would oscillate.
        """
        return max(self.rig.tracker_period, 2 * BETA * self.plate.tau)

    @property
    def leads(self) -> bool:
        """Whether a voltage can be fed forward: its limit is known, and it may change at once."""
        at_once = self.limits.voltage is not None and self.rig.voltage_slew is None
        return at_once and self.method in ("pi", "pll")

    def control(self, bandwidth: float, lead: bool = False) -> DQ | Adaptive:
        """The controller of a closed-loop bandwidth (Hz): the PI's zero on the plate's pole, its gains those
        of G, tau and T; `lead`: with feed-forward."""
        if self.method == "adaptive":
            return self._adaptive(bandwidth)
        plate, T = self.plate, self.T
        lowest, highest = self.voltages()
        K = -math.expm1(-2 * math.pi * bandwidth * T)
        Kp = K / (plate.G * -math.expm1(-T / plate.tau))
        model = Model.of(plate.G, plate.tau, T, self.delay) if lead else None
        pi = PI(Kp, K / plate.G, lowest, highest, self.rig.slew(T), model)
        return DQ(pi, None if plate.f0 is None else self._tracker(plate.f0))

    def promise(self, law: DQ | Adaptive, guard: Guard | None = None) -> Promise:
        """What the controller does with each of the plants: margins, and how it settles, behind its guard."""
        if guard is None:
            return promise(law, self.steps)
        # Readings without noise repeat themselves to the last bit, and no sensor is stuck.
        sound = guard._replace(repeats=NO_LIMIT)
        return promise(law, self.steps, sound, switched(sound, self))

    @property
    def steps(self) -> Steps:
        """Those that are promised."""
        clock = Clock(self.T, self.latency, self.rig.late, self.demodulator)
        return Steps(self.plants, clock, self.amplitude, self.plate.f0)

    @property
    def demodulator(self) -> Demodulator | None:
        """What is exported before the controller; None without f0."""
        return None if self.plate.f0 is None else self.rig.demodulator(self.plate.f0, self.T)

    @property
    def reference_temperature(self) -> float:
        """degC, at which f0 is the resonance."""
        return float(getattr(self.plate.fit, "reference_temperature", None) or 24.0)

    def voltages(self) -> tuple[float, float]:
        """The lowest and the highest."""
        limit = NO_LIMIT if self.limits.voltage is None else self.limits.voltage
        return -limit * self.rig.bipolar, limit

    @property
    def begin(self) -> float:
        """The amplitude to look with, below which no tracker is led by what may be noise."""
        return BEGIN * self.amplitude

    @property
    def window(self) -> tuple[float, float]:
        """Hz, of the drive's frequency."""
        return self.limits.frequency or (0.0, NO_LIMIT)

    def _tracker(self, f0: float) -> Tracker | SignTracker | PLL:
        if self.method == "paper":
            every = float(max(1, round(self.rig.tracker_period / self.T)))
            lowest, highest = self.window
            return SignTracker(f0, every, least=self.begin, lowest=lowest, highest=highest)
        half_bandwidth = self.plate.half_bandwidth
        if self.method == "pll":
            kp = min(1 / self.plate.tau, PLL_RATE / (self.T + self.delay))
            # Between the steps of a coarse source only a quiet estimate decides: its noise goes with kp.
            kp *= 1.0 if self.rig.source(f0) is None else 0.1
            lead = kp / (2 * math.pi)
            gain = lead * self.T / self.plate.tau
            return PLL(lead, gain, half_bandwidth, half_bandwidth, f0, **self._frequency())
        every = float(max(1, round(self.period / self.T)))
        return Tracker(BETA * half_bandwidth, half_bandwidth, f0, every, BETA, **self._frequency(LOUD))

    def _frequency(self, dead: float = QUIET) -> dict[str, Any]:
        source = self.rig.source(self.plate.f0)
        k_T = self.plate.k_T if self.rig.thermometer else None
        if self.rig.thermometer and k_T is None:
            raise ValueError(
                "no temperature feed-forward: k_T is not determined; record a sweep at another temperature"
            )
        step = 0.0 if source is None else source.step
        # What is made, within the window, lies half a step beside the estimate (a timer's steps grow with f).
        given = {"lowest": self.window[0] + 0.52 * step, "highest": self.window[1] - 0.52 * step}
        given |= {"k_T": k_T, "temperature": self.reference_temperature, "least": self.begin}
        return given | {"source": source, "dead_band": dead * step}

    def _adaptive(self, bandwidth: float) -> Adaptive:
        plate, T = self.plate, self.T
        if plate.f0 is None:
            raise ValueError(f"no adaptive controller: {plate.why}; method 'pi' does without")
        lowest, highest = self.voltages()
        late = (self.delay - self.latency) / T
        # Between the steps of a coarse source only a quiet estimate decides: its noise goes with t^-1.5.
        heard = OBSERVER[0] * (1 if self.rig.source(plate.f0) is None else 4)
        # A damping seen before its answer comes eats the margin.
        slow, fast = (math.exp(-T / max(t, 2 * T)) for t in (heard, max(OBSERVER[1], self.delay)))
        return Adaptive(
            plate.G / plate.tau * T, T / plate.tau, 2 * math.pi * T, plate.f0,
            -math.expm1(-2 * math.pi * bandwidth * T), (fast, slow), (0.0,) * round(self.latency / T),
            (0.0,) * int(late), late % 1.0,
            lowest, highest, self.rig.slew(T), **self._frequency(),
        )  # fmt: skip


def calibrated(control: Any, asked: Asked) -> Any:
    """The controller behind the correction of the loop's own sensor, and of a drive that is held."""
    rig, plate = asked.rig, asked.plate
    if rig.sensor is None and not rig.hold:
        return control
    if rig.late and plate.f0 is None:
        raise ValueError(f"the sensor's delay cannot be corrected: {plate.why}")
    correction = rig.shown.correction(plate.f0 or 0.0, rig.hold)
    return Calibrated(control, correction.real, correction.imag)


def guarded(control: DQ | Adaptive, asked: Asked) -> Guard:
    """The controller in its guard: faults after 5 ms, or `Asked.patience`."""
    plate, T = asked.plate, asked.T
    repeats = float(math.ceil(max(STUCK_AFTER / T, ANSWERS * plate.tau / T, asked.patience)))
    period, decay = max(asked.period, T), -math.expm1(-T / plate.tau)
    adc, source = asked.rig.adc, None if plate.f0 is None else asked.rig.source(plate.f0)
    quiet = QUIET_SHARE * asked.amplitude if adc is None else QUIET_UNITS * adc.unit / asked.rig.shown.gain
    # Not looked at where there are so few that one more or less is as much as a fault.
    samples = 0.0 if asked.demodulator is None else asked.demodulator.rate * T
    return Guard(
        control, asked.voltages()[1], abs(plate.G) / (1.0 + asked.ranged.finger), decay, CEILING,
        CEILING * asked.begin, quiet, *asked.window, asked.patience, repeats,
        edge=0.0 if source is None else 1.1 * source.step,
        turn=2 * math.pi * plate.tau * decay, memory=-math.expm1(-T / (MEMORY * period)),
        doubts=float(math.ceil(DOUBTS * period / T)), samples=samples if samples >= FEWEST else 0.0,
        jump=min(decay * abs(plate.G) * asked.voltages()[1] + ROOM * asked.amplitude, NO_LIMIT),
        jumps=decay * (1.0 + 2.0 * max(asked.ranged.finger, HEAVY)), slew=asked.rig.slew(T),
    )  # fmt: skip


def switched(control: Guard, asked: Asked) -> Machine:
    """The machine that switches the guarded controller on."""
    plate, T, amplitude, samples = asked.plate, asked.T, asked.amplitude, asked.plate.tau / asked.T
    tracks = plate.f0 is not None
    limit = float(math.ceil(max(WAIT / T, 100 * samples, TRIES * asked.patience)))
    # voltage over that of the plate of the design
    ratio = abs(plate.G) * asked.plants.rate / np.abs(asked.plants.push)
    most, law = float(np.max(ratio)), control.control
    follower = law if isinstance(law, Adaptive) else law.tracker
    return Machine(
        control, amplitude, asked.begin, amplitude / (RAMP * samples), asked.patience, limit,
        min(MEAN / asked.patience, 1.0), plate.G, plate.f0 or 0.0, asked.voltages(),
        (follower.lowest, follower.highest) if tracks else (0.0, NO_LIMIT),
        _temperatures(asked) if asked.rig.thermometer and tracks else None, asked.reference_temperature,
        headroom=HEADROOM, heaviest=most,
        **({} if tracks else {"beside": (ANY, ANY, NO_LIMIT)}),
        fits=(
            (1 - FITS) * float(np.min(ratio)),
            (1 + FITS) * most if tracks else NO_LIMIT,
            (1 + FITS) * max(most, 1 + HEAVY) if tracks else NO_LIMIT,
        ),
        follows=float(math.ceil(max(FOLLOW_AFTER / T, FOLLOWS * samples, 4 * asked.patience))),
        swings=SWINGS, swing=SWING, swing_time=float(math.ceil(LONGER * (2 * asked.delay / T + 1))),
        sweep=plate.half_bandwidth / (SWEEPS * samples),
    )  # fmt: skip


def _temperatures(asked: Asked) -> tuple[float, float]:
    """What a thermometer may say: the range of the design, else that whose resonances lie in the window."""
    at, k_T, window = asked.reference_temperature, asked.plate.k_T, asked.limits.frequency
    low, high = asked.ranged.warming
    if (low, high) != (0.0, 0.0):
        return at + low, at + high
    if not k_T or window is None:
        return SENSIBLE
    first, last = sorted(at + (edge - (asked.plate.f0 or 0.0)) / k_T for edge in window)
    return max(first, SENSIBLE[0]), min(last, SENSIBLE[1])
