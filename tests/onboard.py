"""The exported C on a bench at the carrier (`tests/firmware/`): compiled, set up, run and read.

The bench is C of the tests' own. It integrates the plate exactly from tick to tick under the synthesised
drive, and calls the controller as firmware does: one interrupt for each sample of the sensor, one for each
control step."""

import re
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import controller

HERE = Path(__file__).parent / "firmware"
RECORD = (
    "time",
    "Wd",
    "Wq",
    "peak",
    "drive",
    "told_d",
    "told_q",
    "V",
    "f",
    "made",
    "reference",
    "fault",
    "mode",
)
FLAGS = ("-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
Event = tuple[float, str, float]  # s, setting of bench.h, value


class Bench(NamedTuple):
    """A compiled bench, and what its scenarios begin with."""

    program: Path
    settings: dict[str, float]

    def run(self, events: Iterable[Event] = (), **settings: float) -> np.recarray:
        """One row for each control step: the plate's own `Wd`, `Wq` against the drive; `peak`, the largest
        amplitude, and `drive`, the largest output of the amplifier, since the row before; what the
        controller was `told`; its V and f, the frequency that is `made`; the `reference`, `fault` and
        `mode`."""
        begin = [(0.0, name, value) for name, value in (self.settings | settings).items()]
        lines = [
            f"{time:.17g} {name} {value:.17g}"
            for time, name, value in [*begin, *sorted(events, key=lambda e: e[0])]
        ]
        done = subprocess.run(
            [self.program], input="\n".join(lines).encode(), capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr.decode()
        return np.frombuffer(done.stdout, np.dtype([(name, float) for name in RECORD])).view(np.recarray)

    def but(self, **settings: float) -> "Bench":
        """The same with other settings."""
        return self._replace(settings=self.settings | settings)


def compiler() -> str | None:
    """A C compiler, None where there is none."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def built(folder: Path, port: str, *flags: str) -> Path:
    """The bench with a port of `tests/firmware/`, and with whatever C lies in the folder."""
    sources = [HERE / "bench.c", HERE / "plant.c", HERE / port, *sorted(folder.glob("*.c"))]
    program = folder / "bench"
    subprocess.run(
        [compiler(), *FLAGS, f"-I{HERE}", f"-I{folder}", *flags, *sources, "-lm", "-o", program], check=True
    )
    return program


def open_loop(folder: Path, **settings: float) -> Bench:
    """Without a controller: `reference` is the voltage, `share` the frequency; `told` the sample and its
    phase."""
    return Bench(built(folder, "port_open.c"), settings)


def closed_loop(loop: controller.Loop, folder: Path, *flags: str, **settings: float) -> Bench:
    """With the exported `loop`: on its own plate, with its rig as it is stated."""
    controller.export_c(loop, folder / "dq_pi.h")
    return Bench(built(folder, "port_dq.c", *flags), as_designed(loop) | settings)


def as_designed(loop: controller.Loop) -> dict[str, float]:
    """The settings of a bench that is what the loop was designed for."""
    rig = loop.rig
    given = {
        "G": loop.G,
        "tau": loop.tau,
        "f0": loop.f0,
        "latency": loop.latency,
        "sample_time": loop.sample_time,
    }
    given |= {"rate": 16 * loop.f0, "reference": loop.amplitude}
    if rig.adc is not None:
        given |= {"rate": rig.adc.rate, "bits": rig.adc.bits, "full": rig.adc.full_scale}
    if rig.dac is not None:
        given |= {"dac_bits": rig.dac.bits, "dac_full": rig.dac.full_scale}
    if rig.timer is not None:
        given |= {"timer": rig.timer}
    if rig.sensor is not None:
        given |= {"gain": rig.sensor.gain, "rotation": rig.sensor.rotation, "delay": rig.sensor.delay}
    return given


def named(prefix: str) -> dict[int, str]:
    """The words of an enumeration of the exported header, such as "DQ_FAULT_", by number."""
    text = (Path(controller.__file__).parent / "c" / "dq.h").read_text(encoding="ascii")
    return {
        int(n): word.lower().replace("_", " ") for word, n in re.findall(rf"{prefix}([A-Z_]+) = (\d+)", text)
    }


def fault_name(code: float) -> str:
    """The word for a fault's number."""
    return named("DQ_FAULT_")[int(code)]
