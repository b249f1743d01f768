"""The example for a Cortex-M4F beside an export, built and run in an emulator."""

import os
import shutil
import signal
import subprocess
from pathlib import Path

import controller

EXAMPLE = Path(controller.__file__).parent / "c" / "examples" / "cortex_m4f"
TOOLS = ("arm-none-eabi-gcc", "qemu-system-arm", "make")
LONGEST = 60  # s of a run, which takes one


def missing() -> str | None:
    """What is not installed, in words."""
    for tool in TOOLS:
        if shutil.which(tool) is None:
            return f"{tool} is not installed"
    said = subprocess.run(
        [TOOLS[0], "-print-file-name=nano.specs"], capture_output=True, text=True, check=True
    )
    return None if Path(said.stdout.strip()).is_absolute() else "newlib for arm-none-eabi is not installed"


def exported(loop: controller.Loop, folder: Path, precision: str | None = None) -> Path:
    """The folder of the example, with the export of `loop` above it."""
    controller.export_c(loop, folder / "dq_pi.h", precision)
    shutil.copytree(EXAMPLE, folder / "example")
    return folder / "example"


def made(target: Path, goal: str) -> str:
    """What `make` of a goal puts out; nothing of it goes on running."""
    words = ["make", "-s", "DQ=..", goal]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, cwd=target, start_new_session=True, **pipes) as running:
        try:
            out, errors = running.communicate(timeout=LONGEST)
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, signal.SIGKILL)
            raise
    assert running.returncode == 0, errors
    assert "warning" not in errors, errors
    return out
