"""A scattering parameter of a plate at the ports of a network analyser, as the admittance that it means.

With the reference impedance R of its ports (Pozar, Microwave Engineering, 4.3):

    reflection at one port             Y = (1 - S11) / (R (1 + S11))
    transmission, plate in series      Y = S21 / (2 R (1 - S21))
    transmission, across the line      Y = 2 (1 - S21) / (R S21)

A resonance of S alone has the loaded Q; that of Y is the plate's own."""

from collections.abc import Mapping

import numpy as np

from sysid.tables.cells import to_number
from sysid.tables.textfile import LogError

SCATTERED = ("reflection", "transmission")
RATIOS = ("impedance", *SCATTERED)  # that an analyser measures, of which an admittance is made
USUAL = "50"  # ohm
ONE, SERIES, ACROSS = "one port", "in series", "across the line"


def placed(where: str, quantity: str, metadata: Mapping[str, str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """The reference impedance (ohm) and the plate's place, as metadata have them, and a note on what is
    assumed. Raises LogError where they are not to be read."""
    stated = metadata.get("reference_ohm")
    notes: tuple[str, ...] = ()
    if stated is None:
        said = f"metadata do not state reference_ohm, which is taken as {USUAL} ohm"
        notes = (f"{said}: the {quantity} is one of the plate behind it",)
    elif not 0 < to_number(stated) < np.inf:
        said = f"found {stated!r}, expected the reference impedance in ohm, above 0"
        raise LogError(f"{where}, metadata 'reference_ohm': {said}")
    known = (ONE,) if quantity == "reflection" else (SERIES, ACROSS)
    place = metadata.get("device", ONE if quantity == "reflection" else "")
    if place not in known:
        expected = " or ".join(f'device = "{of}"' for of in known)
        found = f"found device {place!r}" if place else "found no device"
        said = f"{found} of a {quantity}, expected where the plate is: {expected}"
        raise LogError(f"{where}, metadata 'device': {said}, under [metadata] of a mapping file")
    return {"reference_ohm": stated or USUAL, "device": place}, notes


def admittance(s: np.ndarray, metadata: Mapping[str, str], where: str) -> np.ndarray:
    """(n,) S of a scattering parameter (n,), with what `placed` gives. Raises LogError where it is that of an
    open or a short, of which there is none."""
    ohm, place = to_number(metadata["reference_ohm"]), metadata["device"]
    above, below = {
        ONE: (1 - s, ohm * (1 + s)),
        SERIES: (s, 2 * ohm * (1 - s)),
        ACROSS: (2 * (1 - s), ohm * s),
    }[place]
    if not below.all():
        row = int(np.argmin(below != 0))
        said = f"found {s[row]:g}, of an admittance without bound, expected another"
        raise LogError(f"{where}, row {row} (counted from 0): {said}")
    return above / below


def steepness(s: np.ndarray, metadata: Mapping[str, str]) -> np.ndarray:
    """(n,) |dY/dS|, in S: an analyser's noise is even in S, and so uneven in Y."""
    ohm, place = to_number(metadata["reference_ohm"]), metadata["device"]
    below = {ONE: (1 + s) ** 2 / 2, SERIES: 2 * (1 - s) ** 2, ACROSS: s**2 / 2}[place]
    return 1 / (ohm * np.abs(below))
