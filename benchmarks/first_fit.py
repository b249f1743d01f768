"""Wall time of the first fit, and of the first simulation, in a new process such as a notebook's kernel, beside that of the imports
of a fit in JAX: with the programs that an earlier process kept, and with none."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from peers import in_turns, reached, spread
from startup import FLOOR, LOGS

SCENE = Path(LOGS[0]).parent / "scenes" / "touch.toml"
TASKS = {
    f"fit of {len(LOGS)} logs": f"import sysid; sysid.fit(sysid.read_logs({LOGS!r}))",
    "fit of one log": f"import sysid; sysid.fit(sysid.read_logs({LOGS[-1]!r}))",
    "simulation of a scene": f"import sysid; sysid.Scene.from_toml({str(SCENE)!r}).simulate(seed=0)",
}
WANTED = {"kept": 2, "none": 5}


def section(repeat: int) -> str:
    with tempfile.TemporaryDirectory() as folder:
        switch = {"kept": folder, "none": "off"}

        def runs(command: list[str], programs: str):
            environment = os.environ | {"SYSID_PROGRAMS": switch[programs]}
            return lambda: subprocess.run(command, check=True, env=environment)

        ways = {
            (task, how): runs([sys.executable, "-c", code], how)
            for task, code in TASKS.items()
            for how in switch
        }
        _, took = in_turns(
            {"floor": runs(FLOOR, "none")} | ways, repeat
        )  # the first call of each fills the folder
        size = sum(path.stat().st_size for path in Path(folder).iterdir()) / 2**20
    rows = []
    for task, how in ways:
        ratio = float(np.median(took[task, how] / took["floor"]))
        rows.append(
            f"| {task}, {how} | {spread(took[task, how])} | {reached(ratio, WANTED[how], at_most=True)} |"
        )
    return f"""## The first fit in a new process

Whole processes: the imports, the logs read, the fit. `kept`: with what an earlier process compiled, {size:.1f} MB here; `none`:
with `SYSID_PROGRAMS=off`.

| | s: median (range) | over the imports |
|---|---|---|
| `python -c "import jax, optimistix, emcee, pandas"` | {spread(took["floor"])} | 1 |
{chr(10).join(rows)}
"""
