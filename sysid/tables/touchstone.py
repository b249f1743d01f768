"""Touchstone files of network analysers, one port and two: the scattering parameters, and the admittance that
they mean.

With the reference impedance R of the file (S parameters, Pozar, Microwave Engineering, 4.3):

    one port                    Y = (1 - S11) / (R (1 + S11))
    a device in series          Y = -Y21;     then S11 + S21 = 1
    a device across the line    Y = 1 / Z21;  then S21 - S11 = 1

Which of the last two it is the parameters themselves tell. A resonance of S alone has the loaded Q; that of Y
is the plate's own."""

from typing import Any

import numpy as np

from sysid.tables.csvfile import metadata_of
from sysid.tables.scattered import ACROSS, ONE, SERIES, steepness
from sysid.tables.store import Store, claim_text, library, readable
from sysid.tables.textfile import LogError

SAME = 0.1  # of S21 in series, of S11 across the line, by which a device may be off the rule of its place
_AT = {"": ONE, "series": SERIES, "across": ACROSS}


def read_touchstone(path: str, kind: str) -> Store:
    """The contents of a Touchstone file of one port or two. Raises LogError of any other, and where it is
    damaged."""
    skrf, store = library("skrf", path, kind, "touchstone"), Store(path, kind)
    claim_text(store)
    with readable(store, "Touchstone file"):
        network = skrf.Network()
        network.read_touchstone(path)
        enter(store, network)
        store.constants |= metadata_of((network.comments or "").splitlines())[0]
    return store


def enter(store: Store, network: Any) -> None:
    """Enter the scattering parameters of a network into a store, and the admittance that they mean. More than
    two ports: LogError."""
    frequency, s, ports = network.f, network.s, network.s.shape[1]
    if ports > 2:
        raise LogError(f"{store.path}: found {ports} ports, expected one or two")
    with np.errstate(all="ignore"):
        found = _admittances(network)
    for table, admittance in found.items():
        store.add(table, "frequency_Hz", frequency)
        store.add(table, "Y", admittance, "S")
        store.add(table, "std", _steepness(network, table), "S")
        for row, column in np.ndindex(ports, ports):
            store.add(table, f"S{row + 1}{column + 1}", s[:, row, column])
        store.facts[table] = {"device": _AT[table]}
    store.constants["reference_ohm"] = f"{network.z0[0, 0].real:g}"
    if ports == 2:
        _choose(store, s[:, 0, 0], s[:, 1, 0])


def _admittances(network: Any) -> dict[str, np.ndarray]:
    """The device's admittance (n,), S; of two ports by its place."""
    s = network.s
    if s.shape[1] == 1:
        return {"": (1 - s[:, 0, 0]) / (network.z0[:, 0] * (1 + s[:, 0, 0]))}  # as `tables.scattered` has it
    return {"series": -network.y[:, 1, 0], "across": 1 / network.z[:, 1, 0]}


def _steepness(network: Any, table: str) -> np.ndarray:
    """(n,) noise of that, up to a factor, of noise that is even in S."""
    place, ohm = {"series": SERIES, "across": ACROSS}.get(table, ONE), f"{network.z0[0, 0].real:g}"
    with np.errstate(all="ignore"):
        return steepness(network.s[:, -1, 0], {"reference_ohm": ohm, "device": place})


def _choose(store: Store, s11: np.ndarray, s21: np.ndarray) -> None:
    """Which place the parameters tell, by what they are off its rule; else it is asked for."""
    off = {"series": np.abs(s11 + s21 - 1) / np.abs(s21), "across": np.abs(s21 - s11 - 1) / np.abs(s11)}
    median = {place: float(np.median(values)) for place, values in off.items()}
    place = min(median, key=median.__getitem__)
    if median[place] <= SAME:
        store.default = place
        rule = {"series": "S11 + S21 = 1", "across": "S21 - S11 = 1"}[place]
        store.notes.append(
            f"two ports: the device is taken as one {_AT[place]}, as {rule} within {median[place]:.1g}"
        )
    else:
        said = "found two ports whose parameters are neither in series nor across the line within"
        store.unclear = f'{said} {SAME:g}, expected table = "series" or table = "across" in a mapping file'
