"""`identify --budget`: in how many runs, of logs of all sizes, it is kept."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from long_log import write
from peers import seconds

ALLOWED = 1.2  # times the budget


def section(repeat: int) -> str:
    """Forty times `repeat` runs: sizes even in their logarithm from 1e2 to 1e6, budgets from half to twice what such a log takes."""
    rng, ratios, refused, runs = np.random.default_rng(0), [], 0, 40 * repeat
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": folder}
        path = Path(folder, "log.csv")

        def identify(*options: str) -> int:
            command = [sys.executable, "-m", "sysid", str(path), "-o", f"{folder}/out", *options]
            return subprocess.run(
                command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            ).returncode

        write(path, 1000)
        identify()
        usual = seconds(identify)
        for size in np.geomspace(1e2, 1e6, runs):
            write(path, int(size))
            given = usual * np.exp(rng.uniform(np.log(0.5), np.log(2)))
            codes: list[int] = []
            took = seconds(
                lambda given=given, codes=codes: codes.append(identify("--budget", f"{given:.3g}"))
            )
            refused += codes[0] == 2
            ratios.append(took / given)
    kept = 100 * np.mean(np.array(ratios) <= ALLOWED)
    return f"""## Budget

{runs} runs of `identify --budget`, sizes of the log even in their logarithm from 1e2 to 1e6 rows, budgets from half to twice the {usual:.2g} s that a log
of 1000 rows takes. Time of the whole process over the budget, at most {ALLOWED}: kept in {kept:.0f} % (wanted: 95 % of 200 runs), {refused} of the
runs refused or stopped with exit 2; median {np.median(ratios):.2f}, largest {max(ratios):.2f}.
"""
