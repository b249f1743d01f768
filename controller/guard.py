"""What stands between a controller and the bench: limits that hold whatever it asks for, and faults that end the drive.

A fault makes the voltage zero and is latched: only `init` arms the controller again. Faults are

    1 missing    no finite reading for `patience` samples
    2 dead       the sensor shows less than `floor` of what the drive makes of the plate, for `patience` samples
    3 stuck      the same reading to the last bit for `repeats` samples while the voltage moved by 0.1 % of its limit, or the
                 frequency by 0.2 % of its window
    4 above      |W| above `ceiling` for `patience` samples
    5 edge       the frequency within `edge` Hz of the end of its window for `patience` samples: the resonance is elsewhere, or
                 the sign of Wq is wrong and the tracker ran away
"""

from typing import Any, NamedTuple

from controller import scalar
from controller.dq import Command
from controller.scalar import NO_LIMIT, Full, Span, clip, seen

FAULTS = ("none", "missing", "dead", "stuck", "above", "edge")


class GuardState(NamedTuple):
    """The controller's own state; the latched `fault`, a number of FAULTS; how many samples each has been suspected for; the
    amplitude `expected` of the drive; the last reading, and the voltage and the frequency at which it was first seen; the last
    voltage. `heard` is None where there is no tracker."""

    control: Any
    fault: Any
    missing: Any
    dead: Any
    stuck: Any
    above: Any
    edge: Any
    expected: Any
    d: Any
    q: Any
    since: Any
    heard: Any
    voltage: Any


class GuardInfo(NamedTuple):
    """For people: the latched `fault`, and what the controller itself says."""

    fault: Any
    control: Any


class Guard(NamedTuple):
    """A controller whose voltage stays within +-`limit` and its frequency within `lowest` to `highest`, and that faults stop.

    The drive makes of the plate at least  E <- E + decay (gain |V| - E),  with `gain` that of the plate under the heaviest
    finger.
    """

    control: Any
    limit: float
    ceiling: float
    gain: float
    decay: float
    lowest: float = 0.0
    highest: float = NO_LIMIT
    patience: float = 50.0
    repeats: float = 200.0
    floor: float = 0.05
    edge: float = 0.0

    def init(self) -> GuardState:
        """Armed, at rest."""
        return GuardState(self.control.init(), *(0.0,) * 10, self.rest().frequency, 0.0)

    def rest(self) -> Command:
        """As the controller's own."""
        return self.control.rest()

    def span(self, full: Full) -> GuardState:
        """Where the numbers of the state lie."""
        patient, volts, W = Span(0.0, 2 * self.patience), Span(-self.limit, self.limit), Span(-full.response, full.response)
        counts = (patient, patient, Span(0.0, 2 * self.repeats), patient, patient)
        expected = Span(0.0, self.gain * self.limit)
        window = None if self.rest().frequency is None else Span(self.lowest, self.highest)
        return GuardState(self.control.span(full), Span(0.0, len(FAULTS)), *counts, expected, W, W, volts, window, volts)

    def step(
        self, state: GuardState, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar, share: Any = 1.0
    ) -> tuple[GuardState, Command, GuardInfo]:
        """One sample, as the controller's own; with a fault the voltage is zero and the frequency holds where it was."""
        control, command, said = self.control.step(state.control, reference, W, temperature, xp, share)
        at_edge, frequency = self._window(command.frequency, xp)
        counts, since, heard = self._suspicions(state, W, frequency, xp)
        edge = xp.where(at_edge, state.edge + 1.0, 0.0)
        missing, dead, stuck, above = counts
        fault = state.fault
        for code, suspected in enumerate(
            (missing >= self.patience, dead >= self.patience, self._is_stuck(stuck, state, since, heard, frequency),
             above >= self.patience, edge >= self.patience), 1,
        ):  # fmt: skip
            fault = xp.where((fault == 0.0) & suspected, 1.0 * code, fault)
        voltage = clip(command.voltage, -self.limit, self.limit, xp)
        voltage = xp.where((fault == 0.0) & xp.isfinite(voltage), voltage, 0.0)
        size = xp.where(voltage < 0.0, -voltage, voltage)
        expected = state.expected + self.decay * (self.gain * size - state.expected)
        there = seen(0.0, W, xp)
        d, q = xp.where(there, W.real, state.d), xp.where(there, W.imag, state.q)
        after = GuardState(control, fault, missing, dead, stuck, above, edge, expected, d, q, since, heard, voltage)
        return after, Command(voltage, frequency), GuardInfo(fault, said)

    def _suspicions(self, state: GuardState, W: Any, frequency: Any, xp: Any) -> tuple[tuple[Any, Any, Any, Any], Any, Any]:
        """Samples for which a reading has been missing, dead, the same, above; what was driven when it was first the same."""
        there = seen(0.0, W, xp)
        size = W.real * W.real + W.imag * W.imag
        low, high = self.floor * state.expected, self.ceiling
        same = there & (W.real == state.d) & (W.imag == state.q)
        missing = xp.where(there, 0.0, state.missing + 1.0)
        dead = xp.where(there & (size < low * low), state.dead + 1.0, xp.where(there, 0.0, state.dead))
        stuck = xp.where(same, state.stuck + 1.0, 0.0)
        above = xp.where(there & (size > high * high), state.above + 1.0, xp.where(there, 0.0, state.above))
        heard = None if frequency is None else xp.where(same, state.heard, frequency)
        return (missing, dead, stuck, above), xp.where(same, state.since, state.voltage), heard

    def _is_stuck(self, stuck: Any, state: GuardState, since: Any, heard: Any, frequency: Any) -> Any:
        moved, enough = state.voltage - since, 1e-3 * self.limit
        moves = (moved > enough) | (moved < -enough)
        if frequency is not None:
            turned, far = frequency - heard, 2e-3 * (self.highest - self.lowest)
            moves = moves | (turned > far) | (turned < -far)
        return (stuck >= self.repeats) & moves

    def _window(self, frequency: Any, xp: Any) -> tuple[Any, Any]:
        if frequency is None:
            return False, None
        at_edge = (frequency <= self.lowest + self.edge) | (frequency >= self.highest - self.edge)
        return at_edge, clip(frequency, self.lowest, self.highest, xp)
