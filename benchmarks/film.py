"""The air film: Reynolds' equation beside what is known exactly, and the fast law beside it.  python benchmarks/film.py

sigma is the squeeze number on the full width of a flat strip, e = W/h0, S and A are of the linear response (`stimulator/film.py`).
Seconds are of the processor. Writes film.md beside itself.
"""

import math
import time
import warnings
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from stimulator.errors import RangeWarning
from stimulator.film import (
    FLAT_PAD,
    GROOVED_PAD,
    RIDGE,
    Reynolds,
    film_pressure,
    infinite_overpressure,
    overpressure,
    second_order,
    squeeze_number,
)
from stimulator.layouts import markdown

HERE = Path(__file__).parent
EXCURSIONS = (0.1, 0.25, 0.5, 0.75)


def linear() -> Iterable[dict]:
    for sigma in (1, 10, 100, 1000):
        found = -Reynolds(1e-3, sigma, cells=160, phases=9).periodic().first_harmonic / 1e-3
        k = math.sqrt(sigma / 2)
        below = k * (math.cosh(k) + math.cos(k))
        exact = 1 - (math.sinh(k) + math.sin(k)) / below + 1j * (math.sinh(k) - math.sin(k)) / below
        yield {
            "sigma": sigma, "stiffness": f"{found.real:.5f}", "exact": f"{exact.real:.5f}", "damping": f"{found.imag:.5f}",
            "exact ": f"{exact.imag:.5f}", "error": f"{abs(found - exact):.0e}",
        }  # fmt: skip


def mean() -> Iterable[dict]:
    for sigma in (1, 3, 10, 30, 100, 1000):
        found, exact = (
            Reynolds(0.02, sigma, cells=120, phases=9).periodic().overpressure / 4e-4,
            float(second_order(sigma)),
        )
        yield {
            "sigma": sigma,
            "(P - 1)/e^2 at e = 0.02": f"{found:.5f}",
            "3/2 S - A/4": f"{exact:.5f}",
            "error": f"{found / exact - 1:.1e}",
        }


def trapped() -> Iterable[dict]:
    for e in EXCURSIONS:
        found = Reynolds(e, 1e4, phases=33 if e < 0.7 else 65).periodic().overpressure
        yield {
            "e": e,
            "P at sigma = 1e4": f"{1 + found:.4f}",
            "closed form, no leak": f"{1 + float(infinite_overpressure(e)):.4f}",
        }


def fast() -> Iterable[dict]:
    """Errors of the fast law's overpressure, in per cent of Reynolds'."""
    for sigma in (3, 10, 30, 100, 300, 1000, 10000):
        errors = {
            f"e = {e}": f"{100 * (float(overpressure(e, sigma)) / Reynolds(e, sigma).periodic().overpressure - 1):.1f}"
            for e in EXCURSIONS
        }
        yield {"sigma": sigma, **errors}


def pads() -> Iterable[dict]:
    for name, pad in (
        ("flat, 10 mm", FLAT_PAD),
        ("one ridge, 0.4 mm", RIDGE),
        ("10 mm, grooves of 60 um", GROOVED_PAD),
    ):
        kPa = {f"gap {gap} um": f"{film_pressure(1.0, gap, pad) / 1e3:.3g}" for gap in (2, 3, 4, 5)}
        yield {"pad": name, "sigma at 2 um": f"{squeeze_number(pad.width_m, 2e-6, 32300.0):.3g}", **kPa}


def cost() -> Iterable[dict]:
    for name, film in (
        ("flat strip, defaults", Reynolds(0.5, 300)),
        ("grooved pad", GROOVED_PAD.reynolds(1.0, 2.0, 32300.0)),
    ):
        begun = time.process_time()
        film.periodic()
        yield {
            "film": name,
            "cells": film.cells,
            "phases": film.phases,
            "processor (s)": f"{time.process_time() - begun:.3f}",
        }


def main() -> None:
    warnings.simplefilter("ignore", RangeWarning)  # the table goes beyond the fast law's range on purpose
    parts = {
        "A thin film: the linear strip (Langlois, Blech)": linear(),
        "The mean of second order": mean(),
        "A film that cannot leak": trapped(),
        "The fast law: error of its overpressure, per cent": fast(),
        "Mean overpressure at 32.3 kHz and 1 um, kPa": pads(),
        "What it costs": cost(),
    }
    body = "\n\n".join(f"## {name}\n\n{markdown(rows)}" for name, rows in parts.items())
    about = (__doc__ or "").split("\n\n", 1)[1].strip()
    head = f"# The air film\n\nMade by `python benchmarks/film.py` on {datetime.now(UTC):%Y-%m-%d}.\n\n{about}\n\n"
    (HERE / "film.md").write_text(head + body + "\n", encoding="utf-8")
    Console().print((HERE / "film.md").read_text(encoding="utf-8"), markup=False)


if __name__ == "__main__":
    main()
