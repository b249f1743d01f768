"""Switching a controller on: off, find the resonance, soft start, lock, run, and a fault that stays until it is reset.

    off    no voltage; when enabled, with an amplitude asked for: find
    find   a small amplitude, until the tracker has brought Wq below half of Wd and the amplitude is within a half of it
    soft   the amplitude asked of the loop rises to the wanted one
    lock   until the amplitude is within a tenth, and Wq/Wd within a fifth, for a while
    run    the loop alone
    fault  no voltage, whatever is asked; only a reset leads to off

These conditions are judged by the mean of the latest readings, as half of a single reading of the small amplitude may be noise.

Beside the faults of the guard there is `lost`: the resonance was not found, or the loop did not lock, in time.
"""

from typing import Any, NamedTuple

from controller import scalar
from controller.dq import Command
from controller.guard import FAULTS
from controller.scalar import Full, Span, clip, seen

OFF, FIND, SOFT, LOCK, RUN, FAULT = (float(k) for k in range(6))
MODES = ("off", "find", "soft start", "lock", "run", "fault")
LOST = float(len(FAULTS))
ROUGH, NEAR = 0.5, 0.1  # of the amplitude that is asked, by which it may be off to leave find and lock
ANY = 1e3  # |Wq|/Wd that is no condition


class MachineState(NamedTuple):
    """The loop's own state; the `mode`, a number of MODES; the latched `fault`; samples for which it has been `near`, and has
    `waited` in this mode; the amplitude that was last `asked` of the loop; means of `d` = Wd and `q` = Wq."""

    control: Any
    mode: Any
    fault: Any
    near: Any
    waited: Any
    asked: Any
    d: Any
    q: Any


class MachineInfo(NamedTuple):
    """For people: the latched `fault`, the `mode`, and the loop's own info."""

    fault: Any
    mode: Any
    control: Any


class Machine(NamedTuple):
    """A guarded loop that is switched on in steps. `amplitude` is the most that is asked of it, `find` the amplitude to begin
    with, `ramp` its rise per sample in a soft start. `patience`: samples for which it must be near before it goes on; `limit`:
    samples after which it is lost. `memory`: weight of the latest reading in a mean. `beside`: the largest |Wq|/Wd to leave find
    and lock; ANY where there is no tracker."""

    control: Any
    amplitude: float
    find: float
    ramp: float
    patience: float
    limit: float
    memory: float
    beside: tuple[float, float] = (0.5, 0.2)

    def init(self) -> MachineState:
        """Off, without a fault."""
        return MachineState(self.control.init(), OFF, *(0.0,) * 6)

    def rest(self) -> Command:
        """As the loop's own."""
        return self.control.rest()

    def span(self, full: Full) -> MachineState:
        """Where the numbers of the state lie."""
        waits = Span(0.0, 2 * self.patience), Span(0.0, 2 * self.limit)
        W = Span(-full.response, full.response)
        return MachineState(self.control.span(full), Span(0.0, FAULT), Span(0.0, LOST), *waits, Span(0.0, self.amplitude), W, W)

    def step(
        self,
        state: MachineState,
        reference: Any,
        W: Any,
        temperature: Any = None,
        xp: Any = scalar,
        share: Any = 1.0,
        enable: Any = True,
        reset: Any = False,
    ) -> tuple[MachineState, Command, MachineInfo]:
        """One sample, as the loop's own. The knobs: `reference`, the wanted amplitude; `share`, 0 to 1, of the bandwidth;
        `enable`; and `reset`, which ends a fault."""
        wanted = xp.where(xp.isfinite(reference), clip(reference, 0.0, self.amplitude, xp), state.asked)
        asked = self._asked(state, wanted, xp)
        was = state.mode
        drives = enable & (was > OFF) & (was < FAULT)
        control, command, said = self.control.step(state.control, asked, W, temperature, xp, clip(share, 0.0, 1.0, xp))
        fault = xp.where(state.fault > 0.0, state.fault, xp.where(drives, said.fault, 0.0))
        there = seen(0.0, W, xp)
        d = xp.where(there, state.d + self.memory * (W.real - state.d), state.d)
        q = xp.where(there, state.q + self.memory * (W.imag - state.q), state.q)
        near = xp.where(there & self._near(was, asked, d, q, xp), state.near + 1.0, 0.0)
        waits = ((was == FIND) | (was == LOCK)) & (asked > 0.0)
        waited = xp.where(waits, state.waited + 1.0, 0.0)
        fault = xp.where((fault == 0.0) & drives & (waited >= self.limit), LOST, fault)
        mode = self._mode(was, wanted, asked, near, xp)
        mode = xp.where(enable, mode, OFF)
        mode = xp.where(fault > 0.0, FAULT, mode)
        mode, fault = xp.where(reset, OFF, mode), xp.where(reset, 0.0, fault)
        moved = mode != was
        near, waited = xp.where(moved, 0.0, near), xp.where(moved, 0.0, waited)
        on = (mode > OFF) & (mode < FAULT) & drives
        voltage = xp.where(on, command.voltage, 0.0)
        control = _either(on, control, self.control.init(), xp)
        after = MachineState(control, mode, fault, near, waited, xp.where(on, asked, 0.0), d, q)
        frequency = command.frequency
        frequency = None if frequency is None else xp.where(on, frequency, self.rest().frequency)
        return after, Command(voltage, frequency), MachineInfo(fault, mode, said)

    def _asked(self, state: MachineState, wanted: Any, xp: Any) -> Any:
        """The amplitude that is asked of the loop."""
        find = xp.where(wanted < self.find, wanted, self.find)
        risen = state.asked + self.ramp
        soft = xp.where(risen > wanted, wanted, risen)
        low = xp.where(state.mode == SOFT, soft, find)
        return xp.where(state.mode > SOFT, wanted, low)

    def _near(self, mode: Any, asked: Any, d: Any, q: Any, xp: Any) -> Any:
        """Whether the mean reading is near to what is asked; half as strict while the resonance is looked for."""
        rough = mode == FIND
        off = asked * xp.where(rough, ROUGH, NEAR)
        turned, error = d * xp.where(rough, *self.beside), d - asked
        return (asked > 0.0) & (error < off) & (error > -off) & (q < turned) & (q > -turned)

    def _mode(self, was: Any, wanted: Any, asked: Any, near: Any, xp: Any) -> Any:
        """What comes after `was`."""
        done = near >= self.patience
        mode = xp.where((was == OFF) & (wanted > 0.0), FIND, was)
        mode = xp.where((was == FIND) & done, SOFT, mode)
        mode = xp.where((was == SOFT) & (asked >= wanted), LOCK, mode)
        return xp.where((was == LOCK) & done, RUN, mode)


def _either(condition: Any, yes: Any, no: Any, xp: Any) -> Any:
    """Of two states of one form, number by number; None is no number."""
    if yes is None:
        return None
    if isinstance(yes, tuple):
        items = [_either(condition, a, b, xp) for a, b in zip(yes, no, strict=True)]
        return type(yes)(*items) if hasattr(yes, "_fields") else tuple(items)
    return xp.where(condition, yes, no)
