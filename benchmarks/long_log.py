"""The command on one log of ever more rows, beside the time in which pandas parses the file and ten evaluations of the residuals."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from peers import DRIVE, FREQUENCY, in_turns, reached, since, spread, step, stepped
from throughput import START

ROWS = (10**3, 10**4, 10**5, 10**6, 10**7)
# The peak of a process and of what it started, by the operating system's count, in kilobytes.
CHILD = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True);"
CHILD += " print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"


def write(path: Path, rows: int) -> None:
    """A step as a file; times and responses have the digits of an instrument's."""
    log = step(rows)
    table = pd.DataFrame(
        {"time_us": 1e6 * log.time, "voltage_V": log.drive.astype(int), "frequency_Hz": int(FREQUENCY)}
    )
    table["wd_um"], table["wq_um"] = log.response.real, log.response.imag
    table.to_csv(path, index=False, float_format="%.4f")


def section(repeat: int) -> str:
    rows, numbers = [], 5 * 8
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": folder}
        for n in ROWS:
            path = Path(folder, "log.csv")
            write(path, n)
            peak = []

            def identify(path=path, peak=peak):
                command = [
                    sys.executable,
                    "-c",
                    CHILD,
                    sys.executable,
                    "-m",
                    "sysid",
                    str(path),
                    "-o",
                    f"{folder}/out",
                    "--json",
                ]
                done = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
                peak.append(1024 * int(done.stdout.strip().splitlines()[-1]))

            def parse(path=path):
                table = pd.read_csv(path)
                t = since(1e-6 * table["time_us"].to_numpy(), table["voltage_V"].to_numpy())
                y = table["wd_um"].to_numpy() + 1j * table["wq_um"].to_numpy()
                for _ in range(10):
                    _ = stepped(START, t) - y

            _, took = in_turns({"identify": identify, "parse": parse}, min(repeat, 3) if n < 10**5 else 1)
            ratio = float(np.median(took["identify"] / took["parse"]))
            said = reached(ratio, 1.5, at_most=True) if n == ROWS[-1] else f"{ratio:.3g}"
            memory = max(peak) / (numbers * n)
            kept = reached(memory, 3, at_most=True) if n == ROWS[-1] else f"{max(peak) / 2**20:.0f} MiB"
            rows.append(
                f"| {n:.0e} | {spread(took['identify'])} | {spread(took['parse'])} | {said} | {kept} |"
            )
    table = "\n".join(rows)
    return f"""## Long logs

`identify` in a new process, with the posterior and all files, programs kept: seconds, median (range). Beside it: pandas' `read_csv` and ten
evaluations of the residuals in numpy. Memory: the process's peak, for the longest log over its {numbers // 8} columns in float64. Step to {DRIVE:g} V.

| rows | `identify`, s | pandas and ten residuals, s | ratio | peak memory |
|---|---|---|---|---|
{table}
"""
