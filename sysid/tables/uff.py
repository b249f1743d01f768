"""Universal files (UFF, data set 58): frequency responses and time histories, each a table of its abscissa
and its values."""

from typing import Any

import numpy as np

from sysid.tables.store import Store, claim_text, library, readable
from sysid.tables.textfile import LogError

ABSCISSA = {17: "time_s", 18: "frequency_Hz", 5: "temperature_degC"}
ORDINATE = {
    8: "displacement",
    11: "velocity",
    12: "acceleration",
    13: "force",
    9: "reaction force",
    5: "temperature",
}
NONE = ("", "NONE", "NULL")


def read_uff(path: str, kind: str) -> Store:
    """The functions of a universal file. Raises LogError where it is damaged."""
    pyuff, store = library("pyuff", path, kind, "uff"), Store(path, kind)
    claim_text(store)
    with readable(store, "universal file"):
        file = pyuff.UFF(path)
        places = [k for k, number in enumerate(file.get_set_types()) if int(number) == 58]
        sets = [file.read_sets(k) for k in places]
    if not sets:
        raise LogError(
            f"{path}: found a universal file without a data set 58, expected a function: a frequency"
            f" response, say"
        )
    for k, function in enumerate(sets, 1):
        _enter(store, function, f"function {k}" if len(sets) > 1 else "")
    return store


def _enter(store: Store, function: dict[str, Any], table: str) -> None:
    x, values = np.asarray(function["x"]), np.asarray(function["data"])
    if len(x) != len(values):
        raise LogError(
            f"{store.path}, {table}: found {len(x)} abscissae and {len(values)} values, expected as many"
        )
    unit = str(function.get("ordinate_axis_units_lab", "")).strip()
    name = ORDINATE.get(int(function.get("ordinate_spec_data_type", 0)), "value")
    store.add(table, ABSCISSA.get(int(function.get("abscissa_spec_data_type", 0)), "abscissa"), x)
    store.add(table, name, values, "" if unit.upper() in NONE else unit)
    if (plate := str(function.get("id1", "")).strip()).upper() not in NONE:
        store.constants["id1"] = plate
