"""Instructions and stack of the exported C on a Cortex-M4F, in an emulator:  python benchmarks/cortex_m4f.py

Needs arm-none-eabi-gcc, qemu-system-arm and make. Writes cortex_m4f.md beside itself.
"""

import csv
import io
import re
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path
from types import SimpleNamespace

import controller

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

import emulator  # noqa: E402

PLATE = SimpleNamespace(G=0.02, tau=1.669e-3, f0=32300.0, k_T=-10.16)
RATE, CLOCK = 25e6 / 48, 168e6  # of the example's rig.toml; of a common part
METHODS = ("pi", "paper", "pll", "adaptive")
PRECISIONS = ("single", "double")
# What `-O2` made of the generated code that this one replaced: instructions of a sample and of a step (pi).
BEFORE = {"double": (2728, 7006), "single": (110, 648), "q31": (614, 1578), "q15": (337, 973)}


def exported(method, precision, folder):
    """The example beside an export."""
    rig = controller.Rig.from_toml(emulator.EXAMPLE / "rig.toml")
    loop = controller.design(PLATE, rig=rig, voltage_limit=160.0, amplitude=1.8, method=method)
    return emulator.exported(loop, folder, precision)


def counted(target):
    """{function: (mean, most)} instructions of a call."""
    rows = csv.DictReader(io.StringIO(emulator.made(target, "count")))
    return {row["function"]: (int(row["mean"]), int(row["most"])) for row in rows}


def frames(target):
    """{function: bytes of its own frame}, of the exported C."""
    text = (target / "count.elf-dq_pi.su").read_text(encoding="ascii")
    return {name: int(size) for name, size in re.findall(r":(dq_\w+)\t(\d+)\t", text)}


def stack(target, counts):
    """Bytes that the loop used in all, one interrupt within the other; "-" where the emulated processor,
    at an instruction in a ns, does not come to an end of a sample within its time."""
    if counts["dq_demodulate"][1] > 0.8 * 1e9 / RATE:
        return "-"
    return re.search(r"# stack_bytes: (\d+)", emulator.made(target, "run"))[1]


def rows():
    found, own, others = [], {}, {}
    for precision in PRECISIONS:
        for method in METHODS:
            with tempfile.TemporaryDirectory() as folder:
                target = exported(method, precision, Path(folder))
                counts = counted(target)
                own, others = own or frames(target), others or counts
                sample, step = counts["dq_demodulate"], counts["dq_step"]
                load = (sample[0] * RATE + step[0] * 1e4) / CLOCK
                said = f"| {precision} | {method} | {sample[0]} / {sample[1]} | {step[0]} / {step[1]} | {counts['dq_init'][0]} "
                found.append(f"{said}| {100 * load:.0f} | {stack(target, counts)} |")
    return found, own, others


def main() -> None:
    found, own, others = rows()
    each = "\n".join(f"| {name} | {others[name][1]} | {size} |" for name, size in sorted(own.items()))
    line = "\n"
    before = line.join(f"| {name} | {sample} | {step} |" for name, (sample, step) in BEFORE.items())
    text = f"""# Instructions and stack on a Cortex-M4F

Made by `python benchmarks/cortex_m4f.py` on {date.today():%d %B %Y}, with {compiled()}, `-O2`, in QEMU's mps2-an386. An instruction is one tick of the emulator's
clock (`-icount`), read by the processor's SysTick before and after each call, so that the call and the storing of its result count
too; 600 steps from switching on. Mean / most of a call. Load: of a processor that does {CLOCK / 1e6:.0f} million instructions a second, at {RATE / 1e3:.1f} kHz of samples
and 10 kHz of steps. Stack: bytes that the example's loop used, one interrupt within the other.

| precision | method | dq_demodulate | dq_step | dq_init | load (%) | stack |
|---|---|---|---|---|---|---|
{line.join(found)}

Every function, single precision, `pi`: instructions of a call at most, and bytes of its own frame (`-fstack-usage`):

| function | instructions | frame |
|---|---|---|
{each}

The generated code that this one replaced:

| precision | a sample | a step (pi) |
|---|---|---|
{before}
"""
    (HERE / "cortex_m4f.md").write_text(text, encoding="utf-8")
    print(text)


def compiled():
    """The compiler, in its own words."""
    said = subprocess.run(
        ["arm-none-eabi-gcc", "--version"], capture_output=True, text=True, check=True
    ).stdout
    return said.splitlines()[0]


if __name__ == "__main__":
    main()
