"""Switching a controller on: off, find the resonance, soft start, lock, run, and a fault that stays until it
is reset.

    off    no voltage; when enabled, with an amplitude asked for: find
    find   a small amplitude, until the tracker has brought Wq below half of Wd and the amplitude is within a
           half of it
    soft   the amplitude asked of the loop rises to the wanted one
    lock   until the amplitude is within a tenth, Wq/Wd within a fifth, and the voltage what the plate needs,
           for a while
    run    the loop alone
    fault  no voltage, whatever is asked; only a reset while enable is low leads to off

Until it runs the voltage stays below `headroom` times what is needed for what is asked: in find by a plate
under the heaviest finger of the design, then by the plate as find has seen it. These conditions are judged by
means of the latest readings and commands, as half of a single reading of the small amplitude may be noise.
Beside the faults of the guard there are

    7 lost         the resonance was not found, or the loop did not lock, in time
    9 follow       in run the amplitude is off by a tenth, or |W| by as much more than Wd, for `follows`
                   samples more than it is right: a swing passes through what is right
   10 model        the voltage is not the one that the plate needs: in lock until it is lost, in run for
                   `follows` samples, where it is less than for the plate alone, or more than for a heavy
                   finger
   11 oscillates   the voltage turned `swings` times about its mean by `swing` of its limit, within
                   `swing_time` samples each

For commissioning there are tasks: the amplitude loop without its tracker, a stated voltage and frequency, and
a sweep.
"""

from typing import Any, NamedTuple

from controller import scalar
from controller.dq import Command
from controller.guard import CODES
from controller.scalar import NO_LIMIT, beyond, clip, counted, either, magnitude, seen

OFF, FIND, SOFT, LOCK, RUN, FAULT, OPEN, SWEEP = (float(k) for k in range(8))
MODES = ("off", "find", "soft start", "lock", "run", "fault", "open loop", "sweep")  # as dq_mode in C
TASKS = ("regulate", "amplitude", "open loop", "sweep")  # as dq_task in C
# of the amplitude that is asked, by which it may be off: to leave find; to leave lock, and in run
ROUGH, NEAR = 0.5, 0.1
ANY = 1e3  # |Wq|/Wd, or a ratio of voltages, that is no condition


class Held(NamedTuple):
    """The last good inputs, and how many were not finite or out of range."""

    reference: Any
    share: Any
    temperature: Any
    voltage: Any
    offset: Any
    task: Any
    count: Any


class Means(NamedTuple):
    """Of the latest readings Wd and Wq, of the voltage, and of the amplitude that was asked."""

    d: Any
    q: Any
    voltage: Any
    asked: Any


class Counts(NamedTuple):
    """Samples for which it has been `near` (in find less those for which not), has `waited` in this mode, has
    been `off` in run; how often the voltage has `swung`, how long ago last (`since`), and to which `side`."""

    near: Any
    waited: Any
    off: Any
    swung: Any
    since: Any
    side: Any


class MachineState(NamedTuple):
    """The loop's own state; the `mode`, a number of MODES; the latched `fault`; inputs that are `held`,
    `means` and `counts`; the amplitude that was last `asked` of the loop; the voltage that a unit of it
    `needs`, as find has seen it; the resonance as it was `learned`, and how far a sweep is, Hz above f0."""

    control: Any
    mode: Any
    fault: Any
    held: Held
    means: Means
    counts: Counts
    asked: Any
    needs: Any
    learned: Any
    swept: Any


class MachineInfo(NamedTuple):
    """For people: the latched `fault`, the `mode`, and the loop's own info."""

    fault: Any
    mode: Any
    control: Any


class Machine(NamedTuple):
    """A guarded loop that is switched on in steps. `amplitude` is the most that is asked of it, `find` the
    amplitude to begin with, `ramp` its rise per sample in a soft start. `patience`: samples for which it must
    be near before it goes on; `limit`: samples after which it is lost. `memory`: weight of the latest in a
    mean. `beside`: the largest |Wq|/Wd to leave find, to leave lock, and in run; ANY where there is no
    tracker. `gain`, `f0`: of the plate; `heaviest`: its voltage over what `gain` says under the heaviest
    finger of the design; `fits`: the same, from and to, and to in run. `voltages`, `window` (Hz) and
    `temperatures` (degC; None: no thermometer): ranges of inputs."""

    control: Any
    amplitude: float
    find: float
    ramp: float
    patience: float
    limit: float
    memory: float
    gain: float
    f0: float
    voltages: tuple[float, float]
    window: tuple[float, float]
    temperatures: tuple[float, float] | None = None
    temperature: float = 24.0
    headroom: float = 1.25
    heaviest: float = 1.0
    beside: tuple[float, float, float] = (0.5, 0.2, 0.46)
    fits: tuple[float, float, float] = (0.9, 1.1, 2.75)
    follows: float = 1000.0
    swings: float = 40.0
    swing: float = 0.3
    swing_time: float = 8.0
    sweep: float = 1.0

    def init(self) -> MachineState:
        """Off, without a fault."""
        held = Held(0.0, 1.0, self.temperature, *(0.0,) * 4)
        means, counts = Means(*(0.0,) * 4), Counts(*(0.0,) * 6)
        return MachineState(self.control.init(), OFF, 0.0, held, means, counts, 0.0, 0.0, 0.0, 0.0)

    def rest(self) -> Command:
        """As the loop's own."""
        return self.control.rest()

    def step(
        self, state: MachineState, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar,
        share: Any = 1.0, enable: Any = True, reset: Any = False, task: Any = 0.0, voltage: Any = 0.0,
        offset: Any = 0.0, clipped: Any = False, arrived: Any = None,
    ) -> tuple[MachineState, Command, MachineInfo]:  # fmt: skip
        """One sample, as the loop's own. The knobs: `reference`, the wanted amplitude; `share`, 0 to 1, of
        the bandwidth; `enable`; `reset`, which with enable low ends a fault; the `task`, a number of TASKS;
        the `voltage` of an open loop, and its `offset` from f0, Hz, which is also where a tracker begins.
        `clipped` and `arrived`, the sensor's samples since the step before, as the guard takes them."""
        was = state.mode
        held = self._held(state, (reference, share, temperature, voltage, offset), task, xp)
        opened = (was == OPEN) | (was == SWEEP)
        on = enable & (was > OFF) & (was != FAULT)
        frozen = held.task > 0.0
        asked = self._asked(state, held, opened, xp)
        least = 1.0 / abs(self.gain)
        heaviest = self.heaviest * least
        needed = xp.where(was == FIND, heaviest, clip(state.needs, least, heaviest, xp))
        most = xp.where((was >= FIND) & (was <= LOCK), self.headroom * asked * needed, NO_LIMIT)
        stated, swept = self._stated(state, held, xp)
        control, command, said = self.control.step(
            state.control, asked, W, held.temperature if self.temperatures is not None else None, xp,
            held.share, most, frozen, clipped, (opened, *stated), arrived,
            xp.where(was == RUN, self.find, 0.0),
        )  # fmt: skip
        means = self._means(state.means, W, xp.where(on, asked, 0.0), xp.where(on, command.voltage, 0.0), xp)
        shown = on & (was == FIND) & (means.d > 0.0)
        needs = xp.where(shown, abs(means.voltage) / xp.where(shown, means.d, 1.0), state.needs)
        counts, found = self._judged(state, held, means, asked, command.voltage, most, xp)
        found = xp.where(said.fault > 0.0, said.fault, found)
        counts = either(on, counts, Counts(*(0.0,) * 4, state.counts.since, state.counts.side), xp)
        fault = xp.where(state.fault > 0.0, state.fault, xp.where(on, found, 0.0))
        mode = self._mode(state, held, counts, asked, enable, reset, xp)
        mode = xp.where((fault > 0.0) & (was != FAULT), FAULT, mode)
        fault = xp.where(mode == OFF, 0.0, fault)
        moved = mode != was
        counts = Counts(*(xp.where(moved, 0.0, n) for n in counts[:3]), *counts[3:])
        on = on & (mode > OFF) & (mode != FAULT)
        learned = xp.where(on & (was == RUN), self.control.learned(control), state.learned)
        learned = xp.where(mode == FAULT, 0.0, learned)
        begun = clip(xp.where(frozen, 0.0, learned) + held.offset, *self._window, xp)
        resting = self.control.rest(begun, xp).frequency
        frequency = None if resting is None else xp.where(on, command.frequency, resting)
        after = MachineState(
            either(on, control, self.control.init(begun, xp), xp), mode, fault, held, means, counts,
            xp.where(on, asked, 0.0), needs, learned, xp.where(on, swept, held.offset),
        )  # fmt: skip
        return after, Command(xp.where(on, command.voltage, 0.0), frequency), MachineInfo(fault, mode, said)

    @property
    def _window(self) -> tuple[float, float]:
        return self.window[0] - self.f0, self.window[1] - self.f0

    def _held(self, state: MachineState, given: tuple, task: Any, xp: Any) -> Held:
        """Each input within its range; the last good one where it is not finite; what differs is counted."""
        was, found, count = state.held, [], state.held.count
        ranges = ((0.0, self.amplitude), (0.0, 1.0), self.temperatures, self.voltages, self._window)
        for last, value, span in zip(was[:5], given, ranges, strict=True):
            if span is not None and value is not None:
                last = xp.where(xp.isfinite(value), clip(value, *span, xp), last)
                count = xp.where(last == value, count, count + 1.0)
            found.append(last)
        known = (task >= 0.0) & (task <= len(TASKS) - 1.0)
        task = xp.where(known & (state.mode == OFF), task, was.task)
        return Held._make((*found, task, xp.where(known, count, count + 1.0)))

    def _asked(self, state: MachineState, held: Held, opened: Any, xp: Any) -> Any:
        """The amplitude that is asked of the loop; of an open loop what its voltage makes."""
        wanted, drives = held.reference, self.gain * held.voltage
        find = xp.where(wanted < self.find, wanted, self.find)
        risen = state.asked + self.ramp
        soft = xp.where(risen > wanted, wanted, risen)
        low = xp.where(state.mode == SOFT, soft, find)
        asked = xp.where(state.mode > SOFT, wanted, low)
        return xp.where(opened, magnitude(drives, xp), asked)

    def _stated(self, state: MachineState, held: Held, xp: Any) -> tuple[tuple[Any, Any], Any]:
        """Voltage and frequency of an open loop, a sweep to its end and then nothing; how far it is then."""
        upwards, end = held.offset < 0.0, -held.offset
        over = xp.where(upwards, state.swept > end, state.swept < end)
        sweeps = state.mode == SWEEP
        offset = xp.where(sweeps, state.swept, held.offset)
        voltage = xp.where(sweeps & over, 0.0, held.voltage)
        further = xp.where(upwards, state.swept + self.sweep, state.swept - self.sweep)
        return (voltage, self.f0 + offset), xp.where(sweeps & xp.logical_not(over), further, state.swept)

    def _means(self, was: Means, W: Any, asked: Any, voltage: Any, xp: Any) -> Means:
        there = seen(0.0, W, xp)
        d = xp.where(there, was.d + self.memory * (W.real - was.d), was.d)
        q = xp.where(there, was.q + self.memory * (W.imag - was.q), was.q)
        V = was.voltage + self.memory * (voltage - was.voltage)
        return Means(d, q, V, was.asked + self.memory * (asked - was.asked))

    def _judged(
        self, state: MachineState, held: Held, means: Means, asked: Any, voltage: Any, most: Any, xp: Any
    ) -> tuple[Counts, Any]:
        """The counts of this sample, and the machine's own fault."""
        was = state.mode
        close, suits = self._near(was, held, means, asked, xp), self._fits(was, held, means, xp)
        waits = ((was == FIND) | (was == LOCK)) & (asked > 0.0)
        near = state.counts.near
        near = xp.where(close & suits, near + 1.0, xp.where((was == FIND) & (near > 0.0), near - 1.0, 0.0))
        near = xp.where(waits, near, 0.0)
        waited = counted(waits, state.counts.waited, xp)
        off, follow = self._off(state, held, means, xp)
        swung, since, side = self._swung(state, means, voltage, most, xp)
        found = xp.where(swung >= self.swings, CODES["oscillates"], 0.0)
        found = xp.where(off >= self.follows, follow, found)
        late = xp.where(close & xp.logical_not(suits), CODES["model"], CODES["lost"])
        return Counts(near, waited, off, swung, since, side), xp.where(waited >= self.limit, late, found)

    def _near(self, mode: Any, held: Held, means: Means, asked: Any, xp: Any) -> Any:
        """Whether the mean reading is near to what is asked; less strict while a resonance is looked for."""
        rough = mode == FIND
        off = asked * xp.where(rough, ROUGH, NEAR)
        turned, error = means.d * xp.where(rough, *self.beside[:2]), means.d - asked
        beside = ((means.q < turned) & (means.q > -turned)) | (held.task > 0.0)
        return (asked > 0.0) & (error < off) & (error > -off) & beside

    def _fits(self, mode: Any, held: Held, means: Means, xp: Any) -> Any:
        """Whether the mean voltage is the one that the identified plate needs for what the sensor shows.
        Beside its resonance W = G V / (1 - j q/d), so that G V d = d^2 + q^2."""
        least, most, _ = self.fits
        makes, size = self.gain * means.voltage * means.d, means.d * means.d + means.q * means.q
        return ((mode == FIND) | (makes > least * size)) & ((makes < most * size) | (held.task > 0.0))

    def _off(self, state: MachineState, held: Held, means: Means, xp: Any) -> tuple[Any, Any]:
        """Samples in run for which the amplitude has not been what is asked, or the voltage none that a plate
        needs for it, less those for which both were right; and the fault that this is."""
        beside = beyond(means.q, self.beside[2] * means.d) & (held.task == 0.0)
        slips = beyond(means.asked - means.d, NEAR * means.asked) | beside
        makes = self.gain * means.voltage
        odd = (makes < self.fits[0] * means.d) | ((makes > self.fits[2] * means.d) & (held.task == 0.0))
        judged = (state.mode == RUN) & (means.asked > self.find)
        was = state.counts.off
        off = xp.where(slips | odd, was + 1.0, xp.where(was > 0.0, was - 1.0, 0.0))
        off = xp.where(judged, off, 0.0)
        return off, xp.where(slips, CODES["follow"], CODES["model"])

    def _swung(
        self, state: MachineState, means: Means, voltage: Any, most: Any, xp: Any
    ) -> tuple[Any, Any, Any]:
        """Turns of the voltage about its mean, one soon after the other."""
        was, highest = state.counts, self.voltages[1]
        far, beside = self.swing * xp.where(most < highest, most, highest), voltage - means.voltage
        side = xp.where(beside > far, 1.0, xp.where(beside < -far, -1.0, 0.0))
        judged = (state.mode == LOCK) | (state.mode == RUN)
        turned = side * was.side < 0.0
        swung = xp.where(turned, was.swung + 1.0, xp.where(was.since >= self.swing_time, 0.0, was.swung))
        since = xp.where(turned, 0.0, xp.where(was.since < self.swing_time, was.since + 1.0, was.since))
        return xp.where(judged, swung, 0.0), since, xp.where(side == 0.0, was.side, side)

    def _mode(
        self, state: MachineState, held: Held, counts: Counts, asked: Any, enable: Any, reset: Any, xp: Any
    ) -> Any:
        """What comes after this mode, without a fault."""
        was, wanted = state.mode, held.reference
        done = counts.near >= self.patience
        begun, opened = xp.where(wanted > 0.0, FIND, OFF), xp.where(held.task > 2.0, SWEEP, OPEN)
        mode = xp.where(was == OFF, xp.where(held.task > 1.0, opened, begun), was)
        mode = xp.where((was == FIND) & done, SOFT, mode)
        mode = xp.where((was == SOFT) & (asked >= wanted), LOCK, mode)
        mode = xp.where((was == LOCK) & done, RUN, mode)
        off = xp.logical_not(enable)
        ends = xp.where(was == FAULT, off & reset, off)
        return xp.where(ends, OFF, mode)
