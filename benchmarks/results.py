"""Every figure beside its peers, in one run:  python benchmarks/results.py --repeat 5      (the extra `bench` has the peers)

Ways are timed in turns, in alternating order, so that a busy machine slows all alike; medians, with the range. Writes RESULTS.md
and accuracy.png beside itself. `--only NAME ...` prints those sections and writes nothing.
"""

import argparse
import os
import platform
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command sets it; before numpy is loaded
SECTIONS = ("startup", "first_fit", "accuracy", "throughput", "long_log", "budget", "draws")
PACKAGES = (
    "sysid",
    "jax",
    "numpy",
    "scipy",
    "pandas",
    "emcee",
    "optimistix",
    "lmfit",
    "iminuit",
    "numpyro",
    "blackjax",
    "diffrax",
)


def machine() -> str:
    """What the figures were taken on."""
    names = [
        line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")
    ]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = f"; load average {os.getloadavg()[0]:.1f} at the end" if hasattr(os, "getloadavg") else ""
    return f"{names[0] if names else platform.processor()}, {cores} threads, {platform.system()} on {platform.machine()}{load}"


def _lines(path: str) -> list[str]:
    return Path(path).read_text(encoding="utf-8").splitlines() if Path(path).exists() else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--only", nargs="+", choices=SECTIONS)
    given = parser.parse_args()
    texts: list[str] = []
    for name in given.only or SECTIONS:
        texts.append(import_module(name).section(given.repeat))
        print(texts[-1], flush=True)
        if not given.only:  # what is there stays, whatever comes of the rest
            (Path(__file__).parent / "RESULTS.md").write_text(
                "\n".join([head(given.repeat), *texts]), encoding="utf-8"
            )


def head(repeat: int) -> str:
    return f"""# Figures beside peers

Made by `python benchmarks/results.py --repeat {repeat}`, all in one run, ways in turns. What is wanted stands beside what is reached.

{machine()}; Python {platform.python_version()}; {", ".join(f"{p} {version(p)}" for p in PACKAGES)}.
"""


if __name__ == "__main__":
    main()
