"""Files of numpy, and JSON that is one object or one list."""

import json
import zipfile

import numpy as np
import pandas as pd
import pytest
from refusal import draft_of, refused

from sysid.logs.read import read_logs
from sysid.tables import store

F = 32000.0 + 10.0 * np.arange(40)
Z = 0.05 / (1 + 2j * np.pi * (F - 32200.0) * 1.6e-3)
COLUMNS = {"frequency_Hz": F, "wd_um": Z.real, "wq_um": Z.imag}
LISTS = {name: values.tolist() for name, values in COLUMNS.items()}
ROWS = [dict(zip(LISTS, row, strict=True)) for row in zip(*LISTS.values(), strict=True)]


def same(path, columns=None):
    (log,) = read_logs(path, columns=columns)
    np.testing.assert_array_equal(log.frequency, F)
    np.testing.assert_array_equal(log.response, Z)
    return log


def test_an_archive_of_arrays_is_a_table_of_their_names(tmp_path):
    np.savez(tmp_path / "log.npz", **COLUMNS, voltage_V=50.0, note=np.array("free"))
    assert same(tmp_path / "log.npz").drive[0] == 50.0
    np.savez_compressed(tmp_path / "packed.npz", **COLUMNS, others=np.array([{}, []], object))
    assert "others (objects)" in " ".join(same(tmp_path / "packed.npz").notes)


def test_one_array_has_columns_by_their_numbers_or_its_fields(tmp_path, save):
    np.save(tmp_path / "log.npy", np.asfortranarray(np.transpose([F, Z.real, Z.imag])))
    draft = draft_of(tmp_path / "log.npy")
    assert "frequency = { column = 0" in draft and "x = { column = 1" in draft
    mapping = 'amplitude = "peak"\n[columns]\nfrequency = { column = 0, unit = "Hz" }\n'
    mapping += 'wd = { column = 1, unit = "um" }\nwq = { column = 2, unit = "um" }\n'
    same(tmp_path / "log.npy", save(mapping, "map.toml"))
    np.save(tmp_path / "fields.npy", np.rec.fromarrays([*COLUMNS.values()], names=[*COLUMNS]))
    same(tmp_path / "fields.npy")


def test_numpy_files_that_are_damaged_hold_objects_or_claim_too_much_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "log.npy"
    np.save(path, np.array([{"a": 1}, print], object), allow_pickle=True)
    refused(path, "an array of objects", "not made")
    np.save(path, F)
    path.write_bytes(path.read_bytes()[:-9])
    refused(path, "a damaged numpy array")
    np.savez_compressed(tmp_path / "log.npz", **COLUMNS)
    whole = (tmp_path / "log.npz").read_bytes()
    (tmp_path / "log.npz").write_bytes(whole[:60] + bytes(30) + whole[90:])
    refused(tmp_path / "log.npz", "a damaged numpy archive")
    np.save(path, np.zeros((3, 4)))
    monkeypatch.setattr(store, "MOST", 11)
    refused(path, "12 numbers claimed")


def test_an_archive_of_other_things_is_told_as_such(tmp_path):
    with zipfile.ZipFile(tmp_path / "log.zip", "w") as archive:
        archive.writestr("log.csv", "time_s,w_um")
    refused(tmp_path / "log.zip", "a zip archive", "save it as CSV")


@pytest.mark.parametrize("indent", [None, 1])
@pytest.mark.parametrize(
    "content",
    [
        {**LISTS, "voltage_V": 50},
        [{**row, "voltage_V": 50} for row in ROWS],
        {"voltage_V": 50, "rows": ROWS},
        json.loads(pd.DataFrame(COLUMNS).assign(voltage_V=50).to_json(double_precision=15)),
    ],
    ids=["lists", "rows", "rows within", "pandas"],
)
def test_json_of_one_object_or_one_list_is_a_table(save, content, indent):
    (log,) = read_logs(save(json.dumps(content, indent=indent), "log.json"))
    np.testing.assert_allclose(log.frequency, F, rtol=1e-14)
    np.testing.assert_allclose(log.response, Z, rtol=0, atol=1e-14)
    assert log.drive[0] == 50.0


def test_json_that_is_none_is_refused_where_it_ends_to_be_one(save):
    text = json.dumps({**LISTS}, indent=1)
    refused(save(text[:200], "log.json"), "found no JSON", "one object or list of them")
    refused(save(json.dumps([{"a": 1}, 3], indent=1), "log.json"), "object 2", "found 3")
