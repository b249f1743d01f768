"""Wall time of `identify data/synthetic/*.csv` beside that of the imports that a fit in JAX with Markov chains begins with."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from peers import in_turns, reached, seconds, spread

LOGS = sorted(str(path) for path in (Path(__file__).parents[1] / "data" / "synthetic").glob("*.csv"))
FLOOR = [sys.executable, "-c", "import jax, optimistix, emcee, pandas"]
IDENTIFY = [sys.executable, "-m", "sysid"]


def section(repeat: int) -> str:
    """The first run compiles, into an empty cache folder of its own; the later ones find the programs."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": folder}

        def runs(command: list[str]):
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            return lambda: subprocess.run(command, check=True, env=environment, **quiet)

        floor, whole = runs(FLOOR), runs([*IDENTIFY, *LOGS, "-o", f"{folder}/identified"])
        floor()  # files of the libraries into memory
        imports = seconds(floor)
        first = seconds(whole)
        compiling = stages(folder)
        _, took = in_turns({"floor": floor, "help": runs([*IDENTIFY, "--help"]), "whole": whole}, repeat)
        loading = stages(folder)
    imports = float(np.median([imports, *took["floor"]]))
    ratio = {name: float(np.median(took[name] / took["floor"])) for name in ("help", "whole")}
    return f"""## The command

`identify` on the {len(LOGS)} logs of `data/synthetic/`, with the posterior and all files, in new processes, in turns with the imports.

| | s: median (range) | over the imports |
|---|---|---|
| `python -c "import jax, optimistix, emcee, pandas"` | {spread(took["floor"])} | 1 |
| first run, which compiles | {first:.3g} | {reached(first / imports, 4, at_most=True)} |
| later runs | {spread(took["whole"])} | {reached(ratio["whole"], 2, at_most=True)} |
| `identify --help` | {spread(took["help"])} | {reached(ratio["help"], 0.3, at_most=True)} |

Stages of the first run, of which fit and sample wait for compilers on two threads: {compiling}. Of the last: {loading}.
"""


def stages(folder: str) -> str:
    """Seconds of each stage of the run that wrote into the folder."""
    cost = json.loads(Path(folder, "identified", "fit.json").read_text(encoding="utf-8"))["cost"]
    return ", ".join(f"{row['stage']} {row['seconds']:.2f} s" for row in cost["stages"])
