"""Standard output that is closed, full, or read by somebody who leaves."""

import subprocess
import sys

import pytest

PRESETS = (
    sys.executable,
    "-c",
    "from sysid.command.commands import main; raise SystemExit(main(['presets']))",
)


def run(after: str) -> subprocess.CompletedProcess:
    words = " ".join(f"'{word}'" if " " in word else word for word in PRESETS[:2])
    line = f'{words} "{PRESETS[2]}" {after}'
    return subprocess.run(["bash", "-o", "pipefail", "-c", line], capture_output=True, text=True)


@pytest.mark.parametrize("after, code", [(">&-", 0), ("| head -1", 0), (">/dev/full", 2)])
def test_an_output_that_cannot_be_written_is_told_without_a_traceback(after, code):
    """It was a traceback, and 70 or 1: a failure of the program, or a plate that is not identified."""
    done = run(after)
    assert done.returncode == code, done.stderr
    assert ("standard output cannot be written" in done.stderr) is (code == 2)
    assert "Traceback" not in done.stderr
