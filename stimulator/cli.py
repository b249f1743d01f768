"""The command `simulate`: logs from scene files and touch files, as a bench would have recorded them.

The log of a touch has columns of its own beside those that `identify` reads: the finger, what was sensed of
it, friction.
"""

import dataclasses
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from sysid.scene.cli import Playable, SceneFile
from sysid.scene.cli import main as simulate


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code."""
    return simulate(argv, opened)


def opened(path: str) -> Playable:
    """A file, as the command plays it: a touch, or a scene of the plate."""
    from sysid.scene.toml import read

    if not {"plate_scene", "stroke"} & set(read(Path(path))):
        return SceneFile.opened(path)
    from stimulator.touch import TouchScene

    return TouchFile(TouchScene.from_toml(path))


class TouchFile:
    """A touch, as the command plays it. Its `seed` is that of the file, plus the command's."""

    def __init__(self, scene: Any):
        self.scene = scene

    def total(self, rate: float | None) -> float:
        return self.scene.plate.rows

    def with_plant(self, plant: Any) -> "TouchFile":
        return TouchFile(self.scene.with_plant(plant))

    def write(self, seed: int, path: Path, rate: float | None) -> Iterator[int]:
        from sysid.logs.written import write_log
        from sysid.scene.scene import SceneError

        if rate is not None:
            raise SceneError(
                f"{self.scene.name}: found --waveform, expected a scene of the plate: a touch has rows"
            )
        touch = dataclasses.replace(self.scene, seed=self.scene.seed + seed).run()
        for warning in touch.warnings:
            print(f"simulate: warning: {warning}", file=sys.stderr)
        log = touch.log()
        write_log(log, path, further=touch.columns())
        yield len(log)


if __name__ == "__main__":
    sys.exit(main())
