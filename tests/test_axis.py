"""What settings above or beside the rows say of the columns, as LabVIEW and Tektronix write them.

The truth is a carrier of known drive, gain and phase, or a step of known times, written in each form."""

import numpy as np
import pytest
from refusal import draft_of, refused

from sysid.logs.read import read_logs

STEP = 5e-6  # s from sample to sample
F = 20e3  # Hz
DRIVE, GAIN = 4.0, 0.25  # V, um/V; the response is late by a quarter turn
T = STEP * np.arange(2000)
SAMPLES = DRIVE * np.cos(2 * np.pi * F * T), DRIVE * GAIN * np.sin(2 * np.pi * F * T)
WAVEFORM = 'kind = "waveform"\nquantity = "displacement"\n'


def lvm(names, rows, columns="One", delta=1e-4, zero=0.0, dimension="Time", mark="\t", channels=2):
    """A file of one section, as "Write To Measurement File" writes it."""
    line = mark.join
    every = [str(x) for x in (delta if isinstance(delta, tuple) else (delta,) * channels)]
    zeros = [str(x) for x in (zero if isinstance(zero, tuple) else (zero,) * channels)]
    top = [
        ("LabVIEW Measurement",),
        ("Writer_Version", "2"),
        ("X_Columns", columns),
        ("***End_of_Header***",),
    ]
    return "\n".join([*map(line, top), mark, section(names, rows, every, zeros, dimension, mark), ""])


def section(names, rows, delta, zero, dimension="Time", mark="\t"):
    head = [["Channels", str(len(delta))], ["X_Dimension", *[dimension] * len(delta)], ["X0", *zero]]
    head += [["Delta_X", *delta], ["***End_of_Header***"], [*names, "Comment"], *rows]
    return "\n".join(map(mark.join, head))


def numbers(*columns, form="%.9g"):
    return [[form % x if np.isfinite(x) else "" for x in row] for row in zip(*columns, strict=True)]


def stepped(count=40, step=1e-4):
    t = step * np.arange(count)
    return t, np.where(t > 1e-3, 10.0, 0.0), 0.2 * (1 - np.exp(-np.clip(t - 1e-3, 0, None) / 5e-4))


def check_carrier(log):
    """Wd + jWq of a response late by a quarter turn: GAIN times the drive along d."""
    np.testing.assert_allclose(log.frequency, F, rtol=1e-5)
    np.testing.assert_allclose(log.drive, DRIVE, rtol=1e-3)
    np.testing.assert_allclose(log.response, GAIN * DRIVE, atol=0.01)


@pytest.mark.parametrize("mark", ["\t", ","])
def test_labview_s_axis_is_the_time_that_it_is_said_to_be(save, mark):
    t, voltage, w = stepped()
    (log,) = read_logs(
        save(lvm(["X_Value", "voltage_V", "w_um"], numbers(t, voltage, w), mark=mark), "a.lvm")
    )
    assert log.kind == "transient"
    np.testing.assert_allclose(log.time, t, rtol=1e-9)
    assert "column X_Value is read as time_s, as settings say" in log.notes


def test_labview_s_axis_is_the_frequency_that_it_is_said_to_be(save):
    f = 1000.0 + np.arange(40)
    names, rows = ["X_Value", "voltage_V", "w_um"], numbers(f, 0 * f + 1, 1 / (1 + ((f - 1020) / 5) ** 2))
    (log,) = read_logs(save(lvm(names, rows, delta=1.0, zero=1000.0, dimension="Frequency"), "a.lvm"))
    np.testing.assert_allclose(log.frequency, f)


def test_a_time_that_names_itself_goes_before_labview_s(save):
    t, voltage, w = stepped()
    names = ["X_Value", "time_ms", "voltage_V", "w_um"]
    (log,) = read_logs(save(lvm(names, numbers(np.arange(40), 1e3 * t, voltage, w)), "a.lvm"))
    np.testing.assert_allclose(log.time, t, rtol=1e-9)


def test_an_axis_that_is_not_explained_is_no_time_in_silence(save):
    text = lvm(["X_Value", "voltage_V", "w_um"], numbers(*stepped())).replace("X_Dimension", "X_Size")
    (log,) = read_logs(save(text, "a.lvm"))
    assert "'X_Value' that goes up and states no unit of time" in " ".join(log.warnings)


def test_labview_s_empty_axis_is_counted_from_its_step_in_each_section(save):
    t, voltage, w = stepped()
    names, rows = ["X_Value", "voltage_V", "w_um"], numbers(np.nan * t, voltage, w)
    text = lvm(names, rows, "No") + section(names, rows, ["2e-4"] * 2, ["0"] * 2) + "\n"
    for log, step in zip(read_logs(save("".join(text), "a.lvm")), (1e-4, 2e-4), strict=True):
        assert log.kind == "transient"
        np.testing.assert_allclose(log.time, step * np.arange(len(t)), rtol=1e-9)


def test_labview_s_channels_of_several_clocks_are_refused(save):
    t, voltage, w = stepped()
    names, rows = ["X_Value", "voltage_V", "w_um"], numbers(np.nan * t, voltage, w)
    for more in ({"delta": (1e-4, 2e-4)}, {"zero": (0.0, 5e-5)}):
        refused(save(lvm(names, rows, "No", **more), "a.lvm"), "expected one clock for all")


def test_labview_s_samples_of_a_carrier_need_no_time(save):
    rows = [[cell.replace(".", ",") for cell in row] for row in numbers(np.nan * T, *SAMPLES)]
    path = save(
        lvm(["X_Value", "Drive (V)", "Sensor (V)"], rows, "No", f"{STEP:g}".replace(".", ",")), "a.lvm"
    )
    draft = draft_of(path).replace('"?"', '"displacement"', 1)
    (log,) = read_logs(path, columns=save(draft, "map.toml"))
    check_carrier(log)


def tektronix(values, channel, units=("s", "V")):
    """A channel as a TDS2000 writes it: settings in the first two columns of its rows."""
    beside = [("Record Length", f"{len(T):e}"), ("Sample Interval", f"{STEP:e}"), ("Trigger Point", "0.0"), ("", ""),
              ("Source", channel), ("Vertical Units", units[1]), ("Horizontal Units", units[0]), ("Yzero", "0")]  # fmt: skip
    beside += [("", "")] * (len(T) - len(beside))
    rows = zip(beside, T, values, strict=True)
    return "".join(f"{name},{value},,{t:017.12f},  {y:.5f},\n" for (name, value), t, y in rows)


@pytest.mark.parametrize("units", [("s", "V"), ("s", "Volts")])
def test_settings_beside_rows_say_what_the_columns_are(save, units):
    paths = [save(tektronix(y, f"CH{k}", units), f"F0003CH{k}.CSV") for k, y in enumerate(SAMPLES, start=1)]
    draft = refused(paths).mapping
    columns = draft.partition("[columns]")[2].splitlines()[1:4]
    assert [line.split(" = ")[0] for line in columns] == ["time", "drive", "response"]
    assert all(f'unit = "{unit}"' in line for unit, line in zip("sVV", columns, strict=True))
    (log,) = read_logs(paths, columns=save(draft.replace('"?"', '"displacement"', 1), "map.toml"))
    check_carrier(log)
    by_place = (
        WAVEFORM
        + '[columns]\ntime = { column = 3, unit = "s" }\n'
        + "".join(
            f'{name} = {{ column = 4, unit = "V", file = "*CH{k}.CSV" }}\n'
            for k, name in ((1, "drive"), (2, "response"))
        )
    )
    check_carrier(read_logs(paths, columns=save(by_place, "place.toml"))[0])


def test_remarks_beside_rows_are_no_settings(save):
    """One remark or two beside numbers, or an axis that does not rise, tell nothing."""
    text = "".join(f"{'start' if k == 0 else ''},,{k % 7},{k}\n" for k in range(40))
    error = refused(save(text, "a.csv"))
    assert "settings beside" not in str(error)


@pytest.mark.parametrize(
    "head", ["in s,C1 in V,C2 in V", "Time,C1W1,C2W1\nin s,in V,in V", "Zeit in s,Kanal 1 in V,Kanal 2 in V"]
)
def test_a_unit_behind_in_is_one(save, head):
    """As Rohde & Schwarz, and Germans, write heads."""
    path = save(head + "\n" + "\n".join(",".join(row) for row in numbers(T - 2e-3, *SAMPLES)) + "\n")
    draft = draft_of(path)
    assert draft.count('"?"  #') == draft.count('quantity = "?"') == 1
    check_carrier(read_logs(path, columns=save(draft.replace('"?"', '"displacement"', 1), "map.toml"))[0])
