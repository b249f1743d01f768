"""The command `simulate`: CSV logs from scene files.  Exit codes: 0 written; 2 a scene that cannot be; 130
interrupted.

What a file is, is said by whoever calls `main`: here a scene.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from sysid.shell import add_folder, called, completed, reader, seed


class Playable(Protocol):
    """What a file describes, and how its log is written: in pieces, each with the rows (or samples) that are
    there so far, of `total`. `rate`: raw samples a second instead of rows. Raises SceneError."""

    def total(self, rate: float | None) -> float: ...

    def with_plant(self, plant: Any) -> "Playable": ...

    def write(self, seed: int, path: Path, rate: float | None) -> Iterator[int]: ...


def main(argv: Sequence[str] | None = None, opened: Callable[[str], Playable] | None = None) -> int:
    """Run the command with `argv` (None: the process's own arguments) and return its exit code. `opened`
    reads a file."""
    command = completed(_parser())
    arguments = command.parse_args(argv)
    if arguments.draw is not None and not arguments.fit:
        command.error("found --draw without --fit: expected the fit.json whose posterior it is of")
    if arguments.logs < 1:
        command.error(f"found --logs {arguments.logs}, expected 1 or more")
    from sysid.logs.opening import expanded
    from sysid.report.text import clean
    from sysid.scene.scene import SceneError
    from sysid.scene.toml import fitted, listed
    from sysid.tables.textfile import LogError

    if arguments.effects:
        with reader():
            print(listed())
        return 0
    try:
        paths = expanded(arguments.scenes)
        _told_apart(paths)
        scenes = [(opened or SceneFile.opened)(path) for path in paths]
        if arguments.fit:
            plant = fitted(Path(arguments.fit), arguments.draw)
            scenes = [scene.with_plant(plant) for scene in scenes]
        folder = Path(arguments.folder)
        folder.mkdir(parents=True, exist_ok=True)
        for scene, path in zip(scenes, paths, strict=True):
            for k in range(arguments.seed, arguments.seed + arguments.logs):
                mark = f"_{k}" if arguments.logs > 1 else ""
                _write(scene, k, folder / f"{Path(path).stem}{mark}.csv", arguments.waveform)
    except (SceneError, LogError) as error:
        print(f"{command.prog}: {clean(str(error))}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{command.prog}: cannot be written: {clean(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{command.prog}: interrupted", file=sys.stderr)
        return 130
    return 0


def _told_apart(paths: Sequence[str]) -> None:
    """Raise SceneError for two scenes whose logs would be one file."""
    from sysid.scene.scene import SceneError

    first: dict[str, str] = {}
    for path in paths:
        other = first.setdefault(Path(path).stem, path)
        if other != path:
            raise SceneError(
                f"{path}: found the name of {other}, expected another: logs have their scenes' names"
            )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=called("simulate"),
        description="CSV logs from scene files: what a bench would have recorded.",
        allow_abbrev=False,
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "scenes", nargs="*", default=[], metavar="SCENES", help="scene files (TOML), or patterns"
    )
    what.add_argument(
        "--effects",
        action="store_true",
        help="print all effects with their defaults, as a scene file has them",
    )
    add_folder(parser, ".", "where the logs go")
    parser.add_argument("--seed", type=seed, metavar="N", default=0, help="of the noise (%(default)s)")
    parser.add_argument(
        "--logs",
        type=int,
        metavar="N",
        default=1,
        help="logs of each scene, from successive seeds (%(default)s)",
    )
    parser.add_argument(
        "--fit",
        metavar="FILE",
        help="a fit.json, or its folder, whose plant takes the place of each scene's own",
    )
    parser.add_argument(
        "--draw", type=int, metavar="N", help="draw number N of that fit's posterior instead of its mean"
    )
    parser.add_argument(
        "--waveform", type=float, metavar="HZ", help="raw samples of drive and response at this rate instead"
    )
    return parser


def _write(scene: Playable, seed: int, path: Path, rate: float | None) -> None:
    """Write one log, or its raw samples at `rate`, piece by piece; it appears under its name when it is
    whole."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    from sysid.report.text import clean

    part = path.with_suffix(".part")
    try:
        with Progress(
            console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True
        ) as progress:
            task = progress.add_task(escape(clean(path.name)), total=scene.total(rate))
            for done in scene.write(seed, part, rate):
                progress.update(task, completed=done)
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


class SceneFile:
    """A scene, as `main` plays it."""

    def __init__(self, scene: Any):
        self.scene = scene

    @classmethod
    def opened(cls, path: str) -> "SceneFile":
        from sysid.scene.scene import Scene

        return cls(Scene.from_toml(path))

    def total(self, rate: float | None) -> float:
        return self.scene.rows if rate is None else self.scene.duration * rate

    def with_plant(self, plant: Any) -> "SceneFile":
        return SceneFile(self.scene.with_plant(plant))

    def write(self, seed: int, path: Path, rate: float | None) -> Iterator[int]:
        if rate is not None:
            from sysid.scene.carrier import write_waveform

            yield from write_waveform(self.scene, rate, seed, path)
            return
        from sysid.logs.written import write_log

        done = 0
        for log in self.scene.stream(seed):
            write_log(log, path, append=done > 0)
            done += len(log)
            yield done


if __name__ == "__main__":
    sys.exit(main())
