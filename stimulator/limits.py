"""Where a touch reaches beyond what is known or what the bench can do: each a sentence that begins with a
key."""

from collections.abc import Iterator
from typing import Any

import numpy as np

LEAST_FREQUENCY = 25e3  # Hz: "should be more than 25 kHz" (Ben Messaoud et al., ACTUATOR 2014, after Biet)
LEAST_AMPLITUDE = 1.0  # um, peak: "should be superior to 1 um" (there)
LOST = 0.05  # of the readings: what is called significant elsewhere


def warnings_of(touch: Any) -> Iterator[str]:
    """Of a Touch."""
    scene = touch.scene
    if scene.stroke is not None and scene.stroke.duration > scene.plate.duration * (1 + 1e-9):
        yield (
            f"stroke: it goes on to {scene.stroke.duration:g} s, and the plate's scene ends at"
            f" {scene.plate.duration:g} s: what comes later is not played"
        )
    if scene.friction is not None:
        yield from _film(scene)
    if touch.sensed is not None:
        yield from _sensors(touch)
    if scene.observer is not None and touch.compared is None:
        yield "observer: there is no loop, and so nothing that the open loop is compared with: no judgement"
    if touch.loop is not None and (most := touch.loop.limits.voltage) is not None:
        share = float(np.mean(np.abs(touch.V) >= most * (1 - 1e-9)))
        if share > LOST:
            said = f"the voltage is at its limit, {most:g}, for {100 * share:.0f} % of the time"
            yield f"loop.voltage_limit: {said}"


def _film(scene: Any) -> Iterator[str]:
    if scene.plate.plant.f0 < LEAST_FREQUENCY:
        yield (
            f"friction: the plate vibrates at {scene.plate.plant.f0:g} Hz, and a squeeze film under a finger"
            f" is known above {LEAST_FREQUENCY:g} Hz"
        )
    if scene.texture is not None and scene.texture.amplitude < LEAST_AMPLITUDE:
        yield (
            f"friction: the texture asks for {scene.texture.amplitude:g} um at most, and a squeeze film under"
            f" a finger is known above {LEAST_AMPLITUDE:g} um"
        )


def _sensors(touch: Any) -> Iterator[str]:
    scene, sensed = touch.scene, touch.sensed
    forces = scene.forces
    x, _, force = scene.stroke.at(sensed.time - forces.filter.latency)
    if (most := float(np.max(force))) > forces.range:
        yield f"forces.range: found a force of {most:g} N, above what one sensor shows, {forces.range:g} N"
    if (least := float(np.min(force))) < forces.contact:
        said = f"the force falls to {least:g} N, below {forces.contact:g} N, where the position is held"
        yield f"forces.contact: {said}"
    if scene.texture is None:
        return
    finest, speed = scene.texture.finest, scene.stroke.speed()
    if speed / forces.rate > finest:
        yield (
            f"texture: {finest:g} mm without a change are less than the finger moves between two readings,"
            f" {speed / forces.rate:g} mm: the reference is none of the texture's"
        )
    pressed = force > forces.contact
    lost = float(np.mean(np.abs(sensed.x - x)[pressed] > finest / 2)) if pressed.any() else 0.0
    if lost > LOST:
        yield (
            f"texture: in {100 * lost:.0f} % of the readings the sensed position is off by more than half of"
            f" {finest:g} mm, the texture's shortest stretch without a change: it lies below what the sensors"
            " resolve at this force"
        )
