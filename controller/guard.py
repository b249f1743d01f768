"""The guard between a controller and the bench: limits that always hold, and faults that end the drive.

A fault sets the voltage to zero and is latched: only `init` arms the controller again. Faults are

    1 missing    no finite reading for `patience` samples, or none that a plate can have come to; or, so many
                 more than not, the sensor's own samples between two steps were less than half of what they
                 should be, or steps did not come at all
    2 dead       the sensor shows less than `floor` of the response to the drive, and of what the voltage
                 would reach in time, for `patience` samples, where that is more than `quiet`
    3 stuck      the same reading to the last bit for `repeats` samples since the voltage moved by 0.1 % of
                 its limit, or the frequency by 0.2 % of its window
    4 above      |W| above `ceiling` times what is asked for, or was while the plate came down from it, for
                 `patience` samples
    5 edge       the frequency within `edge` Hz of the end of its window for `patience` samples: the resonance
                 is elsewhere
    6 reversed   Wq responds to the frequency with the wrong sign for `doubts` samples: the tracker is running
                 away
    8 clipped    the sensor's converter at its end for `patience` samples

and those of the machine around it (`controller/machine.py`). A reading whose Wd or Wq is further from the
last one than drive and damping move a plate in a sample is not believed. Without one that is, the plate is
driven with the voltage that holds it where it is, its mean over a time constant, or, where it is shown above
what is allowed, with none: a sensor that shows nothing for some samples would have it driven at the limit.
Reversed is detected before the frequency
reaches the edge, however far that is. At any voltage, Wq' = -Wq/tau + 2 pi (f0 - f) Wd, so moves of f about
its own mean m move Wq by A with A' = -A/tau - 2 pi (f - m) Wd. The sign of Wq is wrong where Wq, less its own
mean, moves the other way by a third to three times as much (a finger shortens tau), and A is above a tenth of
the response to the drive.
"""

from typing import Any, NamedTuple

from controller import scalar
from controller.dq import Command
from controller.rig import Vector
from controller.scalar import NO_LIMIT, beyond, clip, counted, either, magnitude, nan, seen

# as dq_fault in C
FAULTS = (
    "none", "missing", "dead", "stuck", "above", "edge", "reversed",
    "lost", "clipped", "follow", "model", "oscillates", "parameters",
)  # fmt: skip
CODES = {name: float(code) for code, name in enumerate(FAULTS)}
ALIKE = 1 / 3, 3.0  # of its answer to the frequency, between which Wq counts as that, turned round
ANSWER = 0.1  # of what the drive makes of the plate, above which an answer stands out from the noise


class Answer(NamedTuple):
    """The mean frequency `f` and Wq, `q`, of late; by how much the frequency `moves` Wq of a sound plate."""

    f: Any
    q: Any
    moves: Any


class Suspicion(NamedTuple):
    """For how many samples each fault has been suspected."""

    missing: Any
    dead: Any
    stuck: Any
    above: Any
    edge: Any
    turned: Any
    clipped: Any
    behind: Any


class GuardState(NamedTuple):
    """The controller's own state; the latched `fault`, a number of FAULTS; what is `suspected`; the amplitude
    `expected` of the drive and the one that is `allowed`; the last reading, and the voltage and the frequency
    at which it first was repeated; the last voltage. `heard` and `answer` are None where there is no
    tracker. `holds`: the mean voltage, which holds the plate where it is."""

    control: Any
    fault: Any
    suspected: Suspicion
    expected: Any
    holds: Any
    allowed: Any
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
    """A controller whose voltage stays within +-`limit` and its frequency within `lowest` to `highest`, and
    that faults stop.

    The drive makes of the plate at least  E <- E + decay (gain |V| - E),  with `gain` that of the plate under
    the heaviest finger. The amplitude allowed is `ceiling` times what is asked for, `least` at least, and
    falls no faster than the plate. `turn` = 2 pi tau decay, what a sample at 1 Hz beside the mean frequency
    moves Wq by, relative to Wd; `memory`: share of the latest in a mean. `jump`: what the drive, and noise,
    move a reading by from sample to sample at most; `jumps`: the same of what the plate does by itself, of
    |W|. `slew`: the most that the voltage may change in a sample, but for a fault.
    """

    control: Any
    limit: float
    gain: float
    decay: float
    ceiling: float = 1.35
    least: float = 0.0
    quiet: float = 0.0
    lowest: float = 0.0
    highest: float = NO_LIMIT
    patience: float = 50.0
    repeats: float = 200.0
    floor: float = 0.05
    edge: float = 0.0
    turn: float = 0.0
    memory: float = 0.0
    doubts: float = 50.0
    samples: float = 0.0
    jump: float = NO_LIMIT
    jumps: float = 0.0
    slew: float = NO_LIMIT

    def init(self, begun: Any = 0.0, xp: Any = scalar) -> GuardState:
        """Armed, at rest, `begun` Hz above the start frequency."""
        frequency = self.rest(begun, xp).frequency
        answer = None if frequency is None else Answer(frequency, 0.0, 0.0)
        return GuardState(
            self.control.init(begun, xp), 0.0, Suspicion(*(0.0,) * 8), *(0.0,) * 6, frequency, 0.0, answer
        )

    def rest(self, begun: Any = 0.0, xp: Any = scalar) -> Command:
        """As the controller's own."""
        return self.control.rest(begun, xp)

    def learned(self, state: GuardState) -> Any:
        """As the controller's own."""
        return self.control.learned(state.control)

    def step(
        self, state: GuardState, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar,
        share: Any = 1.0, most: Any = NO_LIMIT, frozen: Any = None, clipped: Any = False,
        stated: tuple[Any, Any, Any] | None = None, arrived: Any = None, least: Any = None,
    ) -> tuple[GuardState, Command, GuardInfo]:  # fmt: skip
        """One sample, as the controller's own; with a fault the voltage is zero and the frequency holds where
        it was. `stated`: whether a voltage and a frequency take the place of the controller's, and these.
        `arrived`: finite samples of the sensor since the step before; None: not told."""
        steps = 1.0 if arrived is None or self.samples == 0.0 else arrived * (1.0 / self.samples)
        there = self._believed(state, W, steps, xp)
        told = Vector(xp.where(there, W.real, nan), W.imag)
        control, command, said = self.control.step(
            state.control, reference, told, temperature, xp, share, most, frozen, least
        )
        wanted, faded = self.ceiling * reference, state.allowed - self.decay * state.allowed
        allowed = xp.where(wanted > self.least, wanted, self.least)
        allowed = xp.where(faded > allowed, faded, allowed)
        large = seen(0.0, W, xp) & (W.real * W.real + W.imag * W.imag > allowed * allowed)
        blind = xp.where(large, 0.0, state.holds)
        command = command._replace(voltage=xp.where(there, command.voltage, blind))
        if stated is not None:
            opened, voltage, frequency = stated
            frequency = None if command.frequency is None else frequency
            command = either(opened, Command(voltage, frequency), command, xp)
        at_edge, frequency = self._window(command.frequency, xp)
        suspected, since, heard = self._suspicions(state, W, there, frequency, allowed, xp)
        d, q = xp.where(there, W.real, state.d), xp.where(there, W.imag, state.q)
        answer, turned = self._answered(state, d, q, frequency, xp)
        if frozen is not None:
            at_edge, turned = at_edge & xp.logical_not(frozen), xp.where(frozen, 0.0, turned)
        suspected = suspected._replace(
            edge=counted(at_edge, state.suspected.edge, xp), turned=turned,
            clipped=counted(clipped, state.suspected.clipped, xp),
            behind=self._behind(state.suspected.behind, steps, xp),
        )  # fmt: skip
        fault = xp.where(state.fault == 0.0, self._found(suspected, xp), state.fault)
        most = xp.where(most < self.limit, most, self.limit)
        # Also where a reading is believed anew: the law goes on from where it was.
        voltage = clip(command.voltage, state.voltage - self.slew, state.voltage + self.slew, xp)
        voltage = clip(voltage, -most, most, xp)
        voltage = xp.where((fault == 0.0) & xp.isfinite(voltage), voltage, 0.0)
        expected = state.expected + self.decay * (self.gain * magnitude(voltage, xp) - state.expected)
        holds = state.holds + self.decay * (voltage - state.holds)
        after = GuardState(
            control, fault, suspected, expected, holds, allowed, d, q, since, heard, voltage, answer
        )
        return after, Command(voltage, frequency), GuardInfo(fault, said)

    def _found(self, suspected: Suspicion, xp: Any) -> Any:
        """The first fault that has been suspected for long enough."""
        found, patience = 0.0, self.patience
        for name, count, most in (
            ("missing", suspected.missing, patience), ("missing", suspected.behind, patience),
            ("clipped", suspected.clipped, patience), ("reversed", suspected.turned, self.doubts),
            ("edge", suspected.edge, patience), ("above", suspected.above, patience),
            ("stuck", suspected.stuck, self.repeats), ("dead", suspected.dead, patience),
        ):  # fmt: skip
            found = xp.where(count >= most, CODES[name], found)
        return found

    def _behind(self, was: Any, steps: Any, xp: Any) -> Any:
        """Steps that lack half of their samples, and those that did not come, less the others."""
        return clip(was + xp.where(steps < 0.5, 1.0, steps - 2.0), 0.0, self.patience, xp)

    def _believed(self, state: GuardState, W: Any, steps: Any, xp: Any) -> Any:
        """Whether a reading is there, and one that the plate can have come to in `steps`, some of which may
        not have come."""
        most = self.jump + self.jumps * (magnitude(state.d, xp) + magnitude(state.q, xp))
        most = most * xp.where(steps > 1.0, steps, 1.0)
        far = beyond(W.real - state.d, most) | beyond(W.imag - state.q, most)
        return seen(0.0, W, xp) & xp.logical_not(far)

    def _suspicions(
        self, state: GuardState, W: Any, believed: Any, frequency: Any, high: Any, xp: Any
    ) -> tuple[Suspicion, Any, Any]:
        """Samples for which a reading has been missing, dead, the same though the drive moved, above; what
        was driven when it first was the same."""
        was, there = state.suspected, seen(0.0, W, xp)
        size = W.real * W.real + W.imag * W.imag
        # A plate that was braked, and is held, is as small as its voltage; what is expected still dies away.
        makes = self.gain * magnitude(state.voltage, xp)
        low = self.floor * xp.where(makes < state.expected, makes, state.expected)
        same = there & (W.real == state.d) & (W.imag == state.q)
        missing = xp.where(believed, 0.0, was.missing + 1.0)
        dead = xp.where(there, counted((size < low * low) & (low > self.quiet), was.dead, xp), was.dead)
        # From the first repetition on: what drove the plate there is what holds it, and a sound one stays.
        repeats = same & (was.stuck > 0.0)
        since = xp.where(repeats, state.since, state.voltage)
        heard = None if frequency is None else xp.where(repeats, state.heard, frequency)
        moved = self._moved(state.voltage, since, heard, frequency)
        stuck = xp.where(same, xp.where(moved, was.stuck + 1.0, 1.0), 0.0)
        above = xp.where(there, counted(size > high * high, was.above, xp), was.above)
        return was._replace(missing=missing, dead=dead, stuck=stuck, above=above), since, heard

    def _moved(self, voltage: Any, since: Any, heard: Any, frequency: Any) -> Any:
        """Whether the drive is another than when the reading first was the same."""
        moves = beyond(voltage - since, 1e-3 * self.limit)
        if frequency is None:
            return moves
        return moves | beyond(frequency - heard, 2e-3 * (self.highest - self.lowest))

    def _answered(
        self, state: GuardState, d: Any, q: Any, frequency: Any, xp: Any
    ) -> tuple[Answer | None, Any]:
        """How Wq answers the frequency, and for how many samples it has done so the wrong way round."""
        was = state.answer
        if frequency is None:
            return None, state.suspected.turned
        off, beside = frequency - was.f, q - was.q
        # Both as if the frequency had moved Wq upwards.
        answer, against = magnitude(was.moves, xp), xp.where(was.moves < 0.0, beside, -beside)
        low, high = ALIKE
        wrong = (answer > ANSWER * state.expected) & (against > low * answer) & (against < high * answer)
        moves = (1.0 - self.decay) * was.moves - self.turn * (off * d)
        after = Answer(was.f + self.memory * off, was.q + self.memory * beside, moves)
        return after, counted(wrong, state.suspected.turned, xp)

    def _window(self, frequency: Any, xp: Any) -> tuple[Any, Any]:
        if frequency is None:
            return False, None
        frequency = xp.where(xp.isfinite(frequency), frequency, self.rest().frequency)
        at_edge = (frequency <= self.lowest + self.edge) | (frequency >= self.highest - self.edge)
        return at_edge, clip(frequency, self.lowest, self.highest, xp)
