"""The finite elements of the stimulator's plate beside what is known exactly, and layouts side by side.  python benchmarks/layouts.py

Meshes of the bare plate beside Ritz' method, wavelengths beside the exact wave, the count of modes, then each layout in Kirchhoff's
and in Mindlin's theory, strips moved along the plate, and what it costs: seconds of processor, memory, a second call from the cache.
The plate is 198 x 138 x 1.2 mm of aluminium (69 GPa, 2700 kg/m^3, 0.33), G is at tau = 1.669 ms. Writes layouts.md beside itself.
"""

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from itertools import product
from pathlib import Path

import numpy as np
from rich.console import Console

from stimulator.errors import StimulatorError
from stimulator.layouts import markdown, table
from stimulator.modes import calibrated, modes
from stimulator.plate import ALUMINIUM, BARE, DEFAULT_LAYOUT, LAYOUTS, PlateGeometry, four_strips, laid_out
from stimulator.theory import THEORIES, bare_modes, wavelength, weyl_count

HERE = Path(__file__).parent
TAU = 1.669e-3
FREQUENCY = 32300.0
MINDLIN = 0.97  # of Kirchhoff's frequency: where Mindlin's theory has the same mode


def timed(do: Callable):
    """What it gives, and seconds of processor."""
    begun = time.process_time()
    return do(), time.process_time() - begun


def convergence() -> Iterable[dict]:
    """The straight mode of the bare plate at 31.1 kHz on finer and finer meshes."""
    exact = bare_modes(BARE, (1, 0))
    exact = exact[np.argmin(np.abs(exact - 31123.5))]
    for theory, near, meshes in (
        ("kirchhoff", 31100.0, (4, 6, 7.5, 11, 16)),
        ("mindlin", 30240.0, (2, 3, 4, 5)),
    ):
        for n in meshes:
            found, seconds = timed(
                lambda t=theory, f=near, n=n: modes(BARE, f, t, per_wavelength=n, cache=False)
            )
            beside = f"{100 * (found.mode.f0 / exact - 1):.4f} %" if theory == "kirchhoff" else ""
            yield {
                "theory": theory, "elements a wavelength": n, "unknowns": found.unknowns, "f0 (Hz)": f"{found.mode.f0:.1f}",
                "above Ritz": beside, "processor (s)": f"{seconds:.1f}",
            }  # fmt: skip


def waves() -> Iterable[dict]:
    for theory in THEORIES:
        yield {
            "theory": theory,
            "wavelength (mm)": f"{1e3 * wavelength(ALUMINIUM, 1.2e-3, FREQUENCY, theory):.3f}",
        }


def counts() -> Iterable[dict]:
    every = np.concatenate([bare_modes(BARE, parity) for parity in product((0, 1), repeat=2)])
    for low in range(28000, 36000, 1000):
        found = int(np.sum((every > low) & (every < low + 1000)))
        yield {
            "kHz": f"{low // 1000} to {low // 1000 + 1}",
            "modes": found,
            "Weyl": f"{weyl_count(BARE, low, low + 1000):.1f}",
        }


def found_in(theory: str, near: float, cache: str) -> dict:
    return {name: modes(plate, near, theory, cache=cache) for name, plate in LAYOUTS.items()}


def moved(cache: str) -> dict:
    """The four strips moved away from the middle, on a plate whose default layout resonates at 32.3 kHz."""
    material = calibrated(LAYOUTS[DEFAULT_LAYOUT], FREQUENCY, cache=cache).material
    plate, found = PlateGeometry(material=material), {}
    for mm in np.arange(0.0, 9.7, 1.2):
        out = [p.shifted(np.copysign(1e-3 * mm, p.x - plate.length / 2)) for p in four_strips(plate)]
        try:
            found[f"strips {mm:.1f} mm out"] = modes(laid_out(plate, out), FREQUENCY, cache=cache)
        except StimulatorError:
            continue
    return found


def costs(cache: str) -> Iterable[dict]:
    plate = LAYOUTS[DEFAULT_LAYOUT]
    for theory in ("kirchhoff", "mindlin"):
        _, first = timed(lambda t=theory: modes(plate, theory=t, cache=False))
        modes(plate, theory=theory, cache=cache)
        _, again = timed(lambda t=theory: modes(plate, theory=t, cache=cache))
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        yield {
            "theory": theory, "first call, processor (s)": f"{first:.1f}", "from the cache (s)": f"{again:.3f}",
            "largest memory of the process so far (MB)": f"{memory:.0f}",
        }  # fmt: skip


def main() -> None:
    console = Console()
    with tempfile.TemporaryDirectory() as cache:
        # Memory is asked for first: it only ever grows.
        parts = {"What it costs": list(costs(cache))}
        parts["Meshes, bare plate"] = list(convergence())
        parts["Wavelengths at 32.3 kHz"] = list(waves())
        parts["Modes in 1 kHz, bare plate (Ritz)"] = list(counts())
        parts["Layouts, Kirchhoff, nearest to 32.3 kHz"] = table(found_in("kirchhoff", FREQUENCY, cache), TAU)
        parts["The same modes, Mindlin"] = table(found_in("mindlin", MINDLIN * 31125.0, cache), TAU)
        parts["Four strips of 0.3 mm moved outwards, E calibrated"] = table(moved(cache), TAU)
    body = "\n\n".join(f"## {name}\n\n{markdown(rows)}" for name, rows in parts.items())
    head = f"# Layouts\n\nMade by `python benchmarks/layouts.py` on {datetime.now(UTC):%Y-%m-%d}.\n\n{explanation()}\n\n"
    (HERE / "layouts.md").write_text(head + body + "\n", encoding="utf-8")
    console.print((HERE / "layouts.md").read_text(encoding="utf-8"), markup=False)


def explanation() -> str:
    return (sys.modules[__name__].__doc__ or "").split("\n\n", 1)[1].strip() + (
        "\nNeighbours: offset in Hz; in brackets what the same voltage drives of them, and what the two sensing ceramics read of them,"
        "\nover the chosen mode; the product is what a voltage shows. `straight` is the share of the motion uniform over the width."
    )


if __name__ == "__main__":
    main()
