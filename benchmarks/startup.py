"""Wall time of `identify data/synthetic/*.csv` beside that of the imports it needs:  python benchmarks/startup.py --runs 5

The first run compiles, into an empty cache folder of its own; the later ones find the programs. Runs of the command and of the
imports alternate, so that a busy machine slows both. Writes startup.md beside itself.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

HERE = Path(__file__).parent
LOGS = sorted(str(path) for path in (HERE.parent / "data" / "synthetic").glob("*.csv"))
FLOOR = [sys.executable, "-c", "import jax, optimistix, emcee, pandas"]


def seconds(command: list[str], environment: dict[str, str]) -> float:
    begun = time.perf_counter()
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"XDG_CACHE_HOME": folder}
        command = [sys.executable, "-m", "sysid", *LOGS, "-o", f"{folder}/identified"]
        seconds(FLOOR, environment)  # files of the libraries into memory
        first = seconds(command, environment)
        pairs = [(seconds(FLOOR, environment), seconds(command, environment)) for _ in range(runs)]
        stages = json.loads(Path(folder, "identified", "fit.json").read_text(encoding="utf-8"))["cost"]["stages"]
    floor, later = (median(side) for side in zip(*pairs, strict=True))
    ratios = sorted(b / a for a, b in pairs)
    text = f"""# Wall time of the command

Made by `python benchmarks/startup.py --runs {runs}`: `identify` on the {len(LOGS)} logs of `data/synthetic/`, with the posterior and all
files, in new processes; medians of {runs} alternating pairs.

| | s | over the imports |
|---|---|---|
| `python -c "import jax, optimistix, emcee, pandas"` | {floor:.2f} | 1 |
| first run, which compiles | {first:.1f} | {first / floor:.1f} |
| later runs | {later:.2f} | {median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f}) |

Stages of the last run: {", ".join(f"{row['stage']} {row['seconds']:.2f} s" for row in stages)}.
"""
    (HERE / "startup.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
