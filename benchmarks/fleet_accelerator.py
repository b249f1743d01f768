"""The fit and the screen of plates that are recorded alike, with numpy on one core and with JAX where it has an
accelerator, in turns on the same plates.

python benchmarks/fleet_accelerator.py [--plates 256 4096] [--repeat 2]: prints a table. Where JAX has no
accelerator, its arrays on the processor are tried for it.
"""

import argparse
import time
from collections.abc import Callable, Sequence

import jax
import numpy as np
from fleet_lane import groups

from sysid.fleet import arrays, lane
from sysid.fleet.screen import residual, screened
from sysid.precision import one_thread

LAYOUTS = ((100, False), (300, False), (1000, False), (300, True))  # rows of a step; with a sweep beside it
LONGEST = 110.0  # s, after which no other row is begun
Fitted = tuple[np.ndarray, np.ndarray, np.ndarray]  # theta, covariance, and which plates the screen passes on


def at(place: arrays.Place) -> None:
    """Use this place from here on."""
    arrays.here = lambda: place  # type: ignore[assignment]
    lane._cells.clear()


@one_thread
def solved(plates: Sequence[lane.Plate], screen: bool) -> Fitted:
    """The fits of plates of one layout, in batches of the place's size."""
    key, size, parts = lane.layout(plates[0][1]), lane.together(plates[0][1]), []
    for k in range(0, len(plates), size):
        some = arrays.padded(plates[k : k + size])
        with np.errstate(all="ignore"):
            batch = lane.fit_together(some)
            why = np.full(len(some), "", object)
            if screen:
                lefts = [residual(log, batch.step) for log in batch.logs]
                why = screened(batch, lefts, lane.cells_of(key, plates[0][1])).why
        kept = slice(len(plates[k : k + size]))
        parts.append((batch.theta[kept], batch.covariance[kept], why[kept]))
    theta, covariance, why = (np.concatenate(part) for part in zip(*parts, strict=True))
    return theta, covariance, why


def timed(run: Callable[[], Fitted], repeat: int) -> tuple[Fitted, float, list[float]]:
    """What it gives; seconds of the first call, in which programs and templates are made; and of others."""
    took = []
    for _ in range(1 + repeat):
        begun = time.perf_counter()
        found = run()
        took.append(time.perf_counter() - begun)
    return found, took[0], took[1:]


def row(rows: int, pair: bool, count: int, repeat: int) -> str:
    """One row of the table."""
    plates: list[lane.Plate] = [(group, list(group.logs)) for group in groups(range(count), rows, pair)]
    found, cells = {}, []
    for place in (arrays.PROCESSOR, arrays.ACCELERATOR):
        at(place)
        for screen in (False, True):
            found[screen, place], first, took = timed(lambda s=screen: solved(plates, s), repeat)
            cells += [f"{1e3 * np.median(took) / count:.4f}"]
        cells += [f"{first:.1f}"]
    (theta, covariance, why), (other, wider, said) = (
        found[True, place] for place in (arrays.PROCESSOR, arrays.ACCELERATOR)
    )
    std = np.sqrt(np.einsum("pii->pi", covariance))
    off = np.nanmax(np.abs(other - theta) / std)
    errors = np.nanmax(np.abs(np.sqrt(np.einsum("pii->pi", wider)) / std - 1))
    numpy_ms, jax_ms = float(cells[1]), float(cells[4])
    what = f"step of {rows}" + (" and sweep of 101" if pair else "")
    ours = f"{cells[0]} | {cells[1]} | {cells[3]} | {cells[4]} | {numpy_ms / jax_ms:.1f} | {cells[5]}"
    return f"| {what} | {count} | {ours} | {off:.1g}, {errors:.1g} | {np.sum(why != said)} |"


if __name__ == "__main__":
    command = argparse.ArgumentParser(description=__doc__)
    command.add_argument("--plates", type=int, nargs="+", default=[256, 4096])
    command.add_argument("--repeat", type=int, default=2)
    arguments = command.parse_args()
    begun, device = time.perf_counter(), jax.devices()[0]
    print(
        f"JAX {jax.__version__}: {device.platform}, {device.device_kind}; numpy {np.__version__}, one core\n"
    )
    print(
        "| rows | plates | numpy: fit, ms a plate | with screen | JAX: fit | with screen | numpy over JAX |"
        " s to make programs and templates | differ by (errors; of them) | other ways |\n|" + "---|" * 10
    )
    for count in arguments.plates:
        for layout in LAYOUTS:
            if time.perf_counter() - begun < LONGEST:
                print(row(*layout, count, arguments.repeat), flush=True)
    print(f"\n{time.perf_counter() - begun:.0f} s in all")
