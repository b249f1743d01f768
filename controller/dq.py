"""The paper's structure, figure 7: an amplitude loop on Wd sets the voltage, a tracker brings Wq to zero."""

from typing import Any, NamedTuple

from controller import scalar
from controller.pi import PI, PIInfo, PIState
from controller.scalar import NO_LIMIT, either
from controller.tracker import PLL, SignTracker, Tracker, TrackerInfo, TrackerState


class DQState(NamedTuple):
    """State of both loops; `tracker` is None where there is none."""

    amplitude: PIState
    tracker: TrackerState | None


class Command(NamedTuple):
    """What a controller asks for: peak `voltage` (drive unit), `frequency` in Hz (None: set by others)."""

    voltage: Any
    frequency: Any


class DQInfo(NamedTuple):
    """For people, of both loops."""

    amplitude: PIInfo
    tracker: TrackerInfo | None


class DQ(NamedTuple):
    """PI and tracker in parallel, on one clock. Without a tracker the frequency is set by others."""

    amplitude: PI
    tracker: Tracker | SignTracker | PLL | None

    def init(self, begun: Any = 0.0, xp: Any = scalar) -> DQState:
        """At rest, `begun` Hz above the tracker's start frequency."""
        return DQState(self.amplitude.init(), None if self.tracker is None else self.tracker.init(begun, xp))

    def learned(self, state: DQState) -> Any:
        """The resonance, Hz above the start, at the temperature of the start; zero without a tracker."""
        return 0.0 if self.tracker is None else self.tracker.learned(state.tracker)

    def rest(self, begun: Any = 0.0, xp: Any = scalar) -> Command:
        """What is driven before the first sample has taken effect."""
        tracker = self.tracker
        return Command(0.0, None if tracker is None else tracker.start + tracker.init(begun, xp).offset)

    def step(
        self, state: DQState, reference: Any, W: Any, temperature: Any = None, xp: Any = scalar,
        share: Any = 1.0, most: Any = NO_LIMIT, frozen: Any = None, least: Any = None,
    ) -> tuple[DQState, Command, DQInfo]:  # fmt: skip
        """One sample. In: `reference` and W = Wd + j Wq (peak, response unit), a temperature (degC), a share
        of the PI's gains, the most voltage, whether the tracker is `frozen`, and another `least` of it. Out:
        what to drive with."""
        amplitude, voltage, said = self.amplitude.step(state.amplitude, reference, W, xp, share, most)
        if self.tracker is None:
            return DQState(amplitude, None), Command(voltage, None), DQInfo(said, None)
        # The voltage that made this W is the last one: under one that brakes the sign of Wq is turned.
        output, upwards = state.amplitude.output, self.amplitude.Kp > 0.0
        braked = xp.where(upwards, output < 0.0, output > 0.0)
        tracker, frequency, moved = self.tracker.step(
            state.tracker, reference, W, temperature, braked, xp, least
        )
        if frozen is not None:
            tracker = either(frozen, state.tracker, tracker, xp)
            frequency = self.tracker.start + tracker.offset
        return DQState(amplitude, tracker), Command(voltage, frequency), DQInfo(said, moved)
