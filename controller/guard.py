"""The guard between a controller and the bench: limits that always hold, and faults that end the drive.

A fault sets the voltage to zero and is latched: only `init` arms the controller again. Faults are

    1 missing    no finite reading for `patience` samples
    2 dead       the sensor shows less than `floor` of the response to the drive, and of what the voltage would reach in time, for
                 `patience` samples
    3 stuck      the same reading to the last bit for `repeats` samples since the voltage moved by 0.1 % of its limit, or the
                 frequency by 0.2 % of its window
    4 above      |W| above `ceiling` for `patience` samples
    5 edge       the frequency within `edge` Hz of the end of its window for `patience` samples: the resonance is elsewhere
    6 reversed   Wq responds to the frequency with the wrong sign for `doubts` samples: the tracker is running away

The last is detected before the frequency reaches the edge, however far that is. At any voltage, Wq' = -Wq/tau + 2 pi (f0 - f) Wd,
so moves of f about its own mean m move Wq by A with A' = -A/tau - 2 pi (f - m) Wd. The sign of Wq is wrong where Wq, less its own
mean, moves the other way by a third to three times as much (a finger shortens tau), and A is above a tenth of the response to the
drive.
"""

from typing import Any, NamedTuple

from controller import scalar
from controller.dq import Command
from controller.scalar import NO_LIMIT, Full, Span, clip, seen

FAULTS = ("none", "missing", "dead", "stuck", "above", "edge", "reversed")
ALIKE = 1 / 3, 3.0  # of its answer to the frequency, between which Wq counts as that, turned round
ANSWER = 0.1  # of what the drive makes of the plate, above which an answer stands out from the noise


class Answer(NamedTuple):
    """The mean frequency `f` and the mean `q` = Wq of late; by how much the frequency `moves` Wq of a sound plate."""

    f: Any
    q: Any
    moves: Any


class GuardState(NamedTuple):
    """The controller's own state; the latched `fault`, a number of FAULTS; how many samples each has been suspected for; the
    amplitude `expected` of the drive; the last reading, and the voltage and the frequency at which it first was repeated; the
    last voltage. `heard` and `answer` are None where there is no tracker."""

    control: Any
    fault: Any
    missing: Any
    dead: Any
    stuck: Any
    above: Any
    edge: Any
    turned: Any
    expected: Any
    d: Any
    q: Any
    since: Any
    heard: Any
    voltage: Any
    answer: Answer | None


class GuardInfo(NamedTuple):
    """For people: the latched `fault`, and the controller's own info."""

    fault: Any
    control: Any


class Guard(NamedTuple):
    """A controller whose voltage stays within +-`limit` and its frequency within `lowest` to `highest`, and that faults stop.

    The drive makes of the plate at least  E <- E + decay (gain |V| - E),  with `gain` that of the plate under the heaviest
    finger. `turn` = 2 pi tau decay, what a sample at 1 Hz beside the mean frequency moves Wq by, relative to Wd; `memory`: share
    of the latest in a mean.
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
    turn: float = 0.0
    memory: float = 0.0
    doubts: float = 50.0

    def init(self) -> GuardState:
        """Armed, at rest."""
        frequency = self.rest().frequency
        answer = None if frequency is None else Answer(frequency, 0.0, 0.0)
        return GuardState(self.control.init(), *(0.0,) * 11, frequency, 0.0, answer)

    def rest(self) -> Command:
        """As the controller's own."""
        return self.control.rest()

    def span(self, full: Full) -> GuardState:
        """Where the numbers of the state lie."""
        patient, volts, W = Span(0.0, 2 * self.patience), Span(-self.limit, self.limit), Span(-full.response, full.response)
        counts = (patient, patient, Span(0.0, 2 * self.repeats), patient, patient, Span(0.0, 2 * self.doubts))
        expected = Span(0.0, self.gain * self.limit)
        window = None if self.rest().frequency is None else Span(self.lowest, self.highest)
        answer = None if window is None else Answer(window, W, W)
        return GuardState(self.control.span(full), Span(0.0, len(FAULTS)), *counts, expected, W, W, volts, window, volts, answer)

    def step(
        self, state: GuardState, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar, share: Any = 1.0
    ) -> tuple[GuardState, Command, GuardInfo]:
        """One sample, as the controller's own; with a fault the voltage is zero and the frequency holds where it was."""
        control, command, said = self.control.step(state.control, reference, W, temperature, xp, share)
        at_edge, frequency = self._window(command.frequency, xp)
        counts, since, heard = self._suspicions(state, W, frequency, xp)
        edge = xp.where(at_edge, state.edge + 1.0, 0.0)
        missing, dead, stuck, above = counts
        there = seen(0.0, W, xp)
        d, q = xp.where(there, W.real, state.d), xp.where(there, W.imag, state.q)
        answer, turned = self._answered(state, d, q, frequency, xp)
        suspected = (missing >= self.patience, dead >= self.patience, stuck >= self.repeats,
                     above >= self.patience, edge >= self.patience, turned >= self.doubts)  # fmt: skip
        found = 0.0
        for code, fails in reversed(list(enumerate(suspected, 1))):  # the first in the list is called
            found = xp.where(fails, 1.0 * code, found)
        fault = xp.where(state.fault == 0.0, found, state.fault)
        voltage = clip(command.voltage, -self.limit, self.limit, xp)
        voltage = xp.where((fault == 0.0) & xp.isfinite(voltage), voltage, 0.0)
        size = xp.where(voltage < 0.0, -voltage, voltage)
        expected = state.expected + self.decay * (self.gain * size - state.expected)
        suspicions = (missing, dead, stuck, above, edge, turned)
        after = GuardState(control, fault, *suspicions, expected, d, q, since, heard, voltage, answer)
        return after, Command(voltage, frequency), GuardInfo(fault, said)

    def _suspicions(self, state: GuardState, W: Any, frequency: Any, xp: Any) -> tuple[tuple[Any, Any, Any, Any], Any, Any]:
        """Samples for which a reading has been missing, dead, the same though the drive moved, above; what was driven when it
        first was the same."""
        there = seen(0.0, W, xp)
        size = W.real * W.real + W.imag * W.imag
        # A plate that was braked, and is held, is as small as its voltage, while what is expected still dies away.
        makes = self.gain * xp.where(state.voltage < 0.0, -state.voltage, state.voltage)
        low, high = self.floor * xp.where(makes < state.expected, makes, state.expected), self.ceiling
        same = there & (W.real == state.d) & (W.imag == state.q)
        missing = xp.where(there, 0.0, state.missing + 1.0)
        dead = xp.where(there, xp.where(size < low * low, state.dead + 1.0, 0.0), state.dead)
        # From the first repetition on: what drove the plate there is what holds it, and a sound one stays.
        repeats = same & (state.stuck > 0.0)
        since = xp.where(repeats, state.since, state.voltage)
        heard = None if frequency is None else xp.where(repeats, state.heard, frequency)
        moved = self._moved(state.voltage, since, heard, frequency)
        stuck = xp.where(same, xp.where(moved, state.stuck + 1.0, 1.0), 0.0)
        above = xp.where(there, xp.where(size > high * high, state.above + 1.0, 0.0), state.above)
        return (missing, dead, stuck, above), since, heard

    def _moved(self, voltage: Any, since: Any, heard: Any, frequency: Any) -> Any:
        """Whether the drive is another than when the reading first was the same."""
        moved, enough = voltage - since, 1e-3 * self.limit
        moves = (moved > enough) | (moved < -enough)
        if frequency is not None:
            turned, far = frequency - heard, 2e-3 * (self.highest - self.lowest)
            moves = moves | (turned > far) | (turned < -far)
        return moves

    def _answered(self, state: GuardState, d: Any, q: Any, frequency: Any, xp: Any) -> tuple[Answer | None, Any]:
        """How Wq answers the frequency, and for how many samples it has done so the wrong way round."""
        was = state.answer
        if frequency is None:
            return None, state.turned
        off, beside = frequency - was.f, q - was.q
        # Both as if the frequency had moved Wq upwards.
        down = was.moves < 0.0
        answer, against = xp.where(down, -was.moves, was.moves), xp.where(down, beside, -beside)
        low, high = ALIKE
        wrong = (answer > ANSWER * state.expected) & (against > low * answer) & (against < high * answer)
        moves = (1.0 - self.decay) * was.moves - self.turn * (off * d)
        after = Answer(was.f + self.memory * off, was.q + self.memory * beside, moves)
        return after, xp.where(wrong, state.turned + 1.0, 0.0)

    def _window(self, frequency: Any, xp: Any) -> tuple[Any, Any]:
        if frequency is None:
            return False, None
        frequency = xp.where(xp.isfinite(frequency), frequency, self.rest().frequency)
        at_edge = (frequency <= self.lowest + self.edge) | (frequency >= self.highest - self.edge)
        return at_edge, clip(frequency, self.lowest, self.highest, xp)
