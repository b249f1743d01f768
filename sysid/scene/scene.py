"""A scene: the plant, its inputs over time, and the effects that it names; simulated to a log.

[plant]
G_um_per_V = 0.02
tau_ms = 1.669
f0_kHz = 32.3
k_T = -10.16

[log]
rate_kHz = 10
duration_ms = 30

[inputs]
voltage_V = {steps = [[0, 0], [2e-3, 100]]}
frequency_Hz = 32300

[effects.white_noise]
std_nm = 20
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid.asked import ABSOLUTE_ZERO
from sysid.logs.log import Log
from sysid.model.plant import Plant
from sysid.scene import engine
from sysid.scene.effects import (
    EFFECTS,
    FingerDamping,
    FingerDetuning,
    PhaseReset,
    SelfHeating,
)
from sysid.scene.profile import Profile
from sysid.shown import Shown

FIDELITIES = (*engine.RUNGS, "carrier", "auto")
MOST_STEPS = 16384  # between two rows
NEAR = 1e-6  # of the time between rows: a change of the inputs as near as that to a row is at the row

# What a number of a scene has to be where it means nothing otherwise: a limit, a time constant, a deviation.
SIGNS: dict[str, tuple[str, Callable[[float], bool]]] = {
    "": ("a finite number", math.isfinite),
    "+": ("a number above zero", lambda x: 0 < x < math.inf),
    "0+": ("a number of zero or more", lambda x: 0 <= x < math.inf),
    "share": ("a share, from 0 to 1", lambda x: 0 <= x <= 1),
}


class SceneError(ValueError):
    """A scene that cannot be: says the file, the key, what was found and what was expected."""


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Shown):
    """What happens on the bench. `inputs`: a Profile each of "drive", "frequency" (Hz), and as wanted
    "temperature" (degC), "force" (N) and "contact" (see `effects.Inputs`).

    `rows` rows at `rate` Hz; `kind` "transient" or "steady". `fidelity`: one of FIDELITIES; "carrier" are raw
    samples behind a lock-in; "auto" is the cheapest envelope, with the largest time step, whose error stays
    below `tolerance` times the largest response.

    Raises SceneError for what cannot be combined.
    """

    plant: Plant
    inputs: Mapping[str, Profile]
    rows: int
    rate: float
    effects: tuple = ()
    name: str = "scene"
    kind: str = "transient"
    fidelity: str = "exact"
    tolerance: float = 1e-4
    substeps: int = 1
    amplitude_only: bool = False
    timed: bool = False  # settled points with a time stamp each
    response_unit: str = "um"
    drive_unit: str = "V"
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        order = list(EFFECTS.values())
        effects: list[Any] = sorted(self.effects, key=lambda e: order.index(type(e)))
        if finger := next((e for e in effects if isinstance(e, FingerDamping)), None):
            effects = [
                dataclasses.replace(e, finger=finger) if e.name == "finger_detuning" else e for e in effects
            ]
        object.__setattr__(self, "effects", tuple(effects))
        for said in _contradictions(self):
            raise SceneError(f"{self.name}: {said}")
        object.__setattr__(
            self, "inputs", {name: p.snapped(self.rate, NEAR) for name, p in self.inputs.items()}
        )

    def _brief(self) -> Any:
        from sysid.report.brief import of_scene

        return of_scene(self)

    @classmethod
    def from_toml(cls, path: str | Path) -> "Scene":
        """The scene of a TOML file. Raises SceneError that points at the key."""
        from sysid.scene.toml import load

        return load(Path(path))

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return (self.rows - 1) / self.rate

    def with_plant(self, plant: Plant) -> "Scene":
        """The same scene with another plant: a fit's, or a draw of its posterior."""
        return dataclasses.replace(self, plant=plant)

    @property
    def reference(self) -> float:
        """Hz, from which detunings are counted."""
        return float(self.plant.f0)

    def find(self, kind: Any) -> Any:
        """The scene's effect of a kind, or None."""
        return next((e for e in self.effects if isinstance(e, kind)), None)

    def simulate(self, seed: int = 0) -> Log:
        """The log of this scene. The same seed gives the same noise, whatever else the scene holds; a scene
        of another name has noise of its own."""
        from sysid.scene.simulation import simulate

        return simulate(self, seed)

    def stream(self, seed: int = 0) -> Iterator[Log]:
        """The log in successive pieces, in bounded memory."""
        from sysid.scene.simulation import stream

        return stream(self, seed)


def _contradictions(scene: Scene) -> Iterator[str]:
    """What cannot be combined, and why."""
    plant, find = scene.plant, scene.find
    once = [e.name for e in scene.effects if not getattr(e, "repeats", False)]
    if double := next((n for n in once if once.count(n) > 1), None):
        yield f"found effects.{double} twice, expected it once"
    if plant.G is None or plant.f0 is None:
        yield "found a plant without " + ("G" if plant.G is None else "f0") + ", expected G, tau and f0"
    for name in ("drive", "frequency"):
        if name not in scene.inputs:
            yield f"found no profile of the {name}, expected one"
    if find(SelfHeating) and plant.k_T is None:
        yield "found effects.self_heating and a plant without k_T, expected k_T: heat moves nothing else"
    if scene.fidelity not in FIDELITIES:
        yield f"found fidelity {scene.fidelity!r}, expected one of {', '.join(FIDELITIES)}"
    if scene.kind not in ("transient", "steady"):
        yield f"found kind {scene.kind!r}, expected 'transient' or 'steady'"
    if not (scene.rows >= 1 and np.isfinite(scene.rate) and scene.rate > 0):
        yield f"found {scene.rows} rows at {scene.rate:g} Hz, expected one row or more and a rate above zero"
    if scene.substeps < 1 or scene.substeps > MOST_STEPS:
        yield f"found {scene.substeps} steps between rows, expected 1 to {MOST_STEPS}"
    yield from _of_numbers(scene)
    yield from _of_fingers(scene)
    yield from _of_warmth(scene)
    yield from _of_what_moves(scene)


def _of_numbers(scene: Scene) -> Iterator[str]:
    """Numbers that mean nothing. One that JAX traces is not looked at."""
    for effect in scene.effects:
        for f in dataclasses.fields(effect):
            value, (expected, holds) = getattr(effect, f.name), SIGNS[f.metadata.get("sign", "")]
            if isinstance(value, int | float) and not holds(value):
                yield f"found {value:g} for effects.{effect.name}.{f.name}, expected {expected}"
    for name, least, unit in (("frequency", 0.0, "Hz"), ("temperature", ABSOLUTE_ZERO, "degC")):
        if (given := scene.inputs.get(name)) and (lowest := given.values.min()) <= least:
            yield f"found a {name} of {lowest:g} {unit}, expected more than {least:g}"


def _of_fingers(scene: Scene) -> Iterator[str]:
    """What a finger lacks."""
    find = scene.find
    if find(FingerDamping) and "force" not in scene.inputs:
        yield (
            "found effects.finger_damping and no force, expected inputs.force_N: a finger damps by its force"
        )
    if contact := scene.inputs.get("contact"):
        if not find(FingerDamping):
            yield (
                "found inputs.contact without effects.finger_damping, expected both: a contact is a share"
                " of the damping"
            )
        if contact.values.min() < 0:
            yield (
                f"found a contact of {contact.values.min():g}, expected 0 or more: it is the square of a"
                f" mode's shape"
            )
    if find(FingerDetuning) and not find(FingerDamping):
        yield (
            "found effects.finger_detuning without effects.finger_damping, expected both: the shift is a"
            " share of the damping"
        )


def _of_warmth(scene: Scene) -> Iterator[str]:
    """Effects of a temperature, in scenes that have none."""
    for kind in (EFFECTS["curved"], EFFECTS["temperature_damping"]):
        if scene.find(kind) and "temperature" not in scene.inputs:
            yield f"found effects.{kind.name} and no temperature, expected inputs.temperature_degC"


def _of_what_moves(scene: Scene) -> Iterator[str]:
    """Effects on what moves, in scenes that do not show it."""
    find = scene.find
    for kind in (EFFECTS["duffing"], EFFECTS["self_heating"]):
        if find(kind) and (scene.kind == "steady" or scene.fidelity == "steady"):
            yield (
                f"found effects.{kind.name} in a scene of settled points, expected kind = 'transient': the"
                " response decides its own resonance, and where it settles depends on what was before"
            )
    for kind in (EFFECTS["lock_in"], EFFECTS["delay"], EFFECTS["phase_reset"]):
        if find(kind) and scene.kind == "steady":
            yield (
                f"found effects.{kind.name} in a scene of settled points, expected kind = 'transient':"
                f" nothing moves in it"
            )
    if find(PhaseReset) and scene.fidelity not in ("exact", "auto"):
        yield (
            f"found effects.phase_reset at fidelity '{scene.fidelity}', expected 'exact': the others have"
            f" no phase of their own"
        )
    if find(PhaseReset) and not scene.inputs["frequency"].held:
        yield (
            "found effects.phase_reset and a frequency that ramps, expected steps: a reset at every instant"
            " is no drive"
        )
