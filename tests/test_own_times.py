"""Tables in which each value has times of its own: the truth is the same log with one time, row for row."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from refusal import refused

from sysid.logs.read import read_logs

TIME = np.arange(12) / 1000
WD, WQ = np.sin(300 * TIME), np.cos(300 * TIME)
VOLTS = np.where(TIME < 0.004, 0.0, 5.0)


def table(header, *columns, mark=","):
    """Columns of different lengths, side by side, as a logger writes them."""
    rows = [
        [column[k] if k < len(column) else "" for column in columns] for k in range(max(map(len, columns)))
    ]
    return header + "\n" + "".join(mark.join(map(str, row)) + "\n" for row in rows)


def read(save, text, name="log.csv"):
    (log,) = read_logs([save(text, name)])
    return log


@pytest.fixture
def plain(save):
    return read(save, table("time_s,voltage_V,wd_um,wq_um", TIME, VOLTS, WD, WQ), "plain.csv")


def same(log, plain):
    for name in ("time", "drive", "response", "kind", "drive_unit", "response_unit"):
        np.testing.assert_array_equal(getattr(log, name), getattr(plain, name))
    (note,) = [said for said in log.notes if "times of its own" in said]
    assert "last recorded" in note


@pytest.mark.parametrize(
    ("header", "mark"),
    [
        ("time_s,voltage_V,time_s,wd_um,time_s,wq_um", ","),
        ("voltage Time [s];voltage [V];wd Time [s];wd [um];wq Time [s];wq [um]", ";"),
        ("Zeit in s\tSpannung [V]\tZeit in s\tW_d (um)\tZeit in s\tW_q (um)", "\t"),
    ],
)
def test_the_same_times_before_each_value_are_one(save, plain, header, mark):
    same(read(save, table(header, TIME, VOLTS, TIME, WD, TIME, WQ, mark=mark)), plain)


def test_an_input_recorded_on_change_holds(save, plain):
    """It has two rows, and the response twelve; a change between two rows is in force from the next on."""
    header = "time_s,voltage_V,time_ms,wd_um,time_ms,wq_um"
    for change in (0.004, 0.0032):
        same(read(save, table(header, [-1.0, change], [0, 5], 1000 * TIME, WD, 1000 * TIME, WQ)), plain)


def test_dates_that_begin_at_different_moments(save, plain):
    def stamps(seconds):
        begin = datetime(2026, 2, 3, 12)
        return [(begin + timedelta(seconds=s)).isoformat(timespec="milliseconds") for s in seconds]

    header = "Time,voltage_V,Time,wd_um,Time,wq_um"
    log = read(save, table(header, stamps([-1, 0.004]), [0, 5], stamps(TIME), WD, stamps(TIME), WQ))
    np.testing.assert_allclose(log.time, 1 + TIME, atol=1e-9)  # from the first of all
    for name in ("response", "drive"):
        np.testing.assert_array_equal(getattr(log, name), getattr(plain, name))
    late = table(header, stamps([0.002, 0.004]), [0, 5], stamps(TIME), WD, stamps(TIME), WQ)
    refused(save(late), "line 2", "voltage_V")  # nothing says what it was before


def test_what_cannot_be_one_time_is_refused(save):
    header = "time_s,voltage_V,time_s,wd_um,time_s,wq_um"
    late = table(header, TIME, VOLTS, TIME, WD, TIME + 1e-4, WQ)
    refused(
        save(late), "a time before each value, other times for wd_um than for wq_um", "save them at the same"
    )
    back = table(header, [0.0, 0.5, 0.4], [0, 5, 6], TIME, WD, TIME, WQ)
    refused(save(back), "line 4", "a time of voltage_V below the one before")
    named = table(header.replace("wd_um", "A").replace("wq_um", "B"), TIME, VOLTS, TIME, WD, TIME, WQ)
    refused(
        save(named), "a time before each value (voltage_V, A, B)", "expected names such as voltage_V, wd_um"
    )
    odd = table(header, TIME, VOLTS, TIME, [*WD[:5], "x", *WD[6:]], TIME, WQ)
    refused(save(odd), "line 7", "wd_um")


def test_two_times_in_another_table_say_what_names_one(save):
    text = table("time_s,time_s,wd_um,wq_um", TIME, TIME, WD, WQ)
    refused(save(text), "found time twice", "a mapping file (--columns) can name the column")
