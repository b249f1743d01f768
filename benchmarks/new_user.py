"""From `pip install` to gains as a new user has it, by the clock.  python benchmarks/new_user.py

A new virtual environment, the repository installed into it with pip, and then `identify` on four files that a new user may have: a
bundled log, a CSV with heads of its own, a MATLAB file, and a Touchstone file. Where a file is not understood the drafted mapping
file is saved as the screen says, and each question mark that is left in it counts as an edit. No program was compiled before.
Writes new_user.md beside itself.
"""

import argparse
import os
import re
import subprocess
import tempfile
import time
import venv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import savemat

HERE = Path(__file__).parent
ROOT = HERE.parent
SECONDS, EDITS = 180.0, 2  # at most, of each file, pip included
F0, TAU, G = 32300.0, 1.669041e-3, 0.02  # Hz, s, um/V of the files that are made here
R1, C0 = 2000.0, 2e-9  # ohm, F: the plate as an analyser sees it
ANSWERS = {"amplitude": '"peak"', "quantity": '"displacement"', "phase_sign": "1", "unit": '"um"'}


@dataclass
class Walk:
    """What one file took."""

    name: str
    file: str
    extras: str
    edits: list[str]
    seconds: float
    said: str


def sweep() -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) in Hz and X + jY (n,) in um of a displacement under 100 V, with 0.5 % of noise."""
    f = np.linspace(F0 - 500, F0 + 500, 201)
    rng = np.random.default_rng(0)
    W = 100 * G / (1 + 2j * np.pi * (f - F0) * TAU)
    return f, -1j * W + 0.005 * 100 * G * (rng.normal(size=(2, f.size)).T @ [1, 1j])


def written(folder: Path) -> dict[str, tuple[Path, str]]:
    """The four files, and the extra that each asks for."""
    f, signal = sweep()
    foreign, matlab, ports = (folder / name for name in ("sweep.csv", "sweep.mat", "plate.s1p"))
    rows = np.column_stack([f / 1e3, signal.real, signal.imag, np.full(f.size, 100.0)])
    np.savetxt(foreign, rows, "%.8g", ";", header="Freq (kHz);X (um);Y (um);Drive (V)", comments="")
    savemat(matlab, {"frequency_Hz": f, "X_um": signal.real, "Y_um": signal.imag, "voltage_V": 100.0})
    s = 2j * np.pi * f
    L1 = R1 * TAU / 2
    y = 1 / (R1 + s * L1 + (2 * np.pi * F0) ** 2 * L1 / s) + s * C0
    y *= 1 + 0.002 * np.random.default_rng(1).normal(size=f.size)
    r = (1 - 50 * y) / (1 + 50 * y)
    np.savetxt(ports, np.column_stack([f, r.real, r.imag]), "%.12g", header="# Hz S RI R 50", comments="")
    return {
        "a bundled log": (ROOT / "data" / "synthetic" / "step_100V_24C.csv", ""),
        "a foreign CSV": (foreign, ""),
        "a MATLAB file": (matlab, ""),
        "a Touchstone file": (ports, "[touchstone]"),
    }


def answered(draft: str) -> tuple[str, list[str]]:
    """A drafted mapping file without its question marks, and the keys that a user has to fill in."""
    edits, lines = [], []
    for line in draft.splitlines():
        if line.startswith("#") or '"?"' not in line:
            lines.append(line)
            continue
        key = line.partition("=")[0].strip()
        edits.append(key)
        lines.append(re.sub(r'"\?"', ANSWERS.get(key, ANSWERS["unit"]), line))
    return "\n".join(lines) + "\n", edits


def identify(python: Path, path: Path, folder: Path, environment: dict[str, str]) -> tuple[str, list[str]]:
    """What the screen says of a file in the end, and the edits on the way."""
    command, edits = [str(python.parent / "identify"), str(path), "-o", str(folder / "out")], []

    def run(*more: str) -> subprocess.CompletedProcess:
        return subprocess.run([*command, *more], cwd=folder, env=environment, capture_output=True, text=True)

    done = run()
    if done.returncode == 2:
        draft = done.stderr[done.stderr.index("\n\n") :] if "\n\n" in done.stderr else done.stderr
        text, edits = answered("\n".join(line for line in draft.splitlines() if _is_toml(line)))
        (folder / "map.toml").write_text(text)
        done = run("--columns", "map.toml")
    gains = next((line for line in done.stdout.splitlines() if line.startswith("gains")), "no gains")
    return f"exit {done.returncode}; {' '.join(gains.split()).partition(';')[0]}", edits


def _is_toml(line: str) -> bool:
    return bool(re.match(r"\s*(\[\w+\]|\w+ = |#)", line))


def walked(name: str, path: Path, extras: str) -> Walk:
    """One file, from a new environment on."""
    with tempfile.TemporaryDirectory() as folder:
        begun, here = time.perf_counter(), Path(folder)
        venv.create(here / "venv", with_pip=True)
        python = here / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
        target = f"{ROOT}{extras}"
        subprocess.run([python, "-m", "pip", "install", "-q", target], check=True, capture_output=True)
        kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "SYSID_PROGRAMS")}
        environment = kept | {"SYSID_PROGRAMS": str(here / "programs"), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
        said, edits = identify(python, path, here, environment)
        return Walk(name, path.name, extras, edits, time.perf_counter() - begun, said)


def table(walks: list[Walk]) -> str:
    rows = [
        f"| {w.name} | `pip install .{w.extras}`, `identify {w.file}` | {w.seconds:.0f} | {len(w.edits)}"
        f"{': ' + ', '.join(w.edits) if w.edits else ''} | {w.said} |"
        for w in walks
    ]
    good = all(w.seconds <= SECONDS and len(w.edits) <= EDITS and "gains" in w.said for w in walks)
    return f"""# A new user, by the clock

`python benchmarks/new_user.py`: for each file a new virtual environment, `pip install` of the repository, and `identify`, on
{os.cpu_count()} processors and with pip's own cache. At most {SECONDS:.0f} s and {EDITS} edits each: {"reached" if good else "not reached"}.

| | what is typed | s | edits of the drafted mapping file | what is said |
|---|---|---|---|---|
{chr(10).join(rows)}
"""


def main() -> None:
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    command.add_argument("--print", action="store_true", help="print the table, write nothing")
    arguments = command.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        walks = [walked(name, *of) for name, of in written(Path(folder)).items()]
    if arguments.print:
        print(table(walks))
    else:
        (HERE / "new_user.md").write_text(table(walks), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
