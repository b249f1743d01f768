"""Empty cells in a few of many rows: the rows are left out and named, or refused where the log tells most."""

import numpy as np
import pytest
from refusal import refused

import sysid
from sysid.logs.missing import LOST
from sysid.logs.read import read_logs

TAU, F0 = 1.67e-3, 32300.0
F = np.arange(31800.0, 32801.0, 5.0)
T = 1e-4 * np.arange(400)
V = np.where(T > 4e-3, 10.0, 0.0)


def noise(count, seed):
    rng = np.random.default_rng(seed)
    return 1e-4 * (rng.standard_normal(count) + 1j * rng.standard_normal(count))


SWEEP = 0.05 / (1 + 2j * np.pi * (F - F0) * TAU) + noise(len(F), 1)
RISE = 0.02 * V * (1 - np.exp(-np.clip(T - 4.1e-3, 0, None) / TAU)) + noise(len(T), 2).real


def table(head, columns, gaps=(), cell="", column=-1):
    rows = [[repr(float(x)) for x in row] for row in zip(*columns, strict=True)]
    for k in gaps:
        rows[k][column] = cell
    return head + "\n" + "".join(",".join(row) + "\n" for row in rows)


def sweep(gaps=(), cell="", column=-1, step=1):
    columns = (F[::step], SWEEP[::step].real, SWEEP[::step].imag)
    return table("frequency_Hz,wd_um,wq_um", columns, gaps, cell, column)


def step(gaps=(), cell="", column=-1):
    return table("time_s,voltage_V,w_um", (T, V, RISE), gaps, cell, column)


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "--", "n/a", "9.91E+37", "-nan(ind)"])
def test_rows_of_a_sweep_are_left_out_counted_and_named(save, cell):
    (log,) = read_logs(save(sweep([3, 50, 180], cell)))
    kept = np.delete(np.arange(len(F)), [3, 50, 180])
    np.testing.assert_array_equal(log.response, SWEEP[kept])
    np.testing.assert_array_equal(log.frequency, F[kept])
    (note,) = log.notes
    assert note.startswith(
        "3 of 201 rows left out, without a number in wq_um: line 5, line 52, line 182; 1.5 %"
    )


@pytest.mark.parametrize("column", [0, 1, 2])
def test_any_column_may_lack_a_cell(save, column):
    (log,) = read_logs(save(sweep([20], column=column)))
    assert len(log) == 200


def test_a_fit_without_the_rows_is_as_sure_as_the_rule_says(save):
    """Each error grows by less than 1/sqrt(1 - LOST), and the values move by less than that tells."""
    whole, less = (sysid.fit(read_logs(save(text))) for text in (sweep(), sweep([3, 50, 99, 180])))
    for name in ("f0", "tau", "G"):
        a, b = whole.parameters.get(name), less.parameters.get(name)
        if a.std:
            assert b.std / a.std < 1.1 / np.sqrt(
                1 - LOST
            )  # the noise is estimated anew, of 401 numbers: by 3.5 %
            assert abs(b.value - a.value) < 4 * a.std * np.sqrt(LOST / (1 - LOST))  # of what is lost, alone


def test_the_rows_that_tell_most_are_refused(save):
    """Of a coarse sweep those on the resonance, 4 of 21; those far from it not."""
    refused(
        save(sweep([10], step=10)),
        "line 12",
        "'wq_um'",
        "an empty cell",
        "a finite number",
        "% of what the log tells",
    )
    refused(save(sweep([9], step=10)), "line 11", "% of what the log tells")
    (log,) = read_logs(save(sweep([1], step=5)))
    assert len(log) == 40


@pytest.mark.parametrize("gaps", [range(12), range(0, 201, 15)])
def test_many_rows_are_refused(save, gaps):
    refused(save(sweep(gaps)), "line 2", "an empty cell", f"the {len(gaps)} rows", "% of what the log tells")


@pytest.mark.parametrize("cell", ["OL", "overload", "inf", "1,5", "x", "#####"])
def test_a_cell_that_is_not_empty_is_refused(save, cell):
    """An overload tells something, and a slip of the pen is the reader's to mend."""
    refused(save(sweep([3], f'"{cell}"')), "line 5", "'wq_um'", "a finite number")


def test_rows_of_a_step(save):
    (log,) = read_logs(save(step([5, 300, 310])))
    assert len(log) == 397 and "line 7, line 302, line 312" in log.notes[0]
    (log,) = read_logs(save(step([300], column=1)))  # its drive is that of the rows beside it
    assert len(log) == 399
    for row in (41, 42, 43):
        refused(save(step([row])), f"line {row + 2}", "'w_um'")
    for row in (40, 41):  # when the drive changed is not known
        refused(save(step([row], column=1)), f"line {row + 2}", "'voltage_V'")


def test_a_change_of_the_inputs_where_nothing_else_happens_is_refused(save):
    """A second drive as small as the noise: the row tells little, but the plate goes on from it."""
    drive = np.where(T > 0.03, V + 1e-4, V)
    row = int(np.argmax(T > 0.03))
    text = table("time_s,voltage_V,w_um", (T, drive, RISE), [row])
    refused(save(text), f"line {row + 2}", "drive or frequency change there")


@pytest.mark.parametrize(("dwell", "settles"), [(0.05, True), (0.02, True), (0.003, False), (0.0002, False)])
def test_a_timed_sweep_is_left_without_rows_only_where_it_settles(save, dwell, settles):
    columns = (dwell * np.arange(len(F)), F, SWEEP.real, SWEEP.imag)
    path = save(table("time_s,frequency_Hz,wd_um,wq_um", columns, [3, 50]))
    if settles:
        assert len(read_logs(path)[0]) == 199
    else:
        refused(path, "line 5", "drive or frequency change there")


def test_a_waveform_s_samples_are_left_out_at_its_ends_alone(save):
    time = 1e-6 * np.arange(4000)
    drive = np.sin(2 * np.pi * 40e3 * time)
    head, columns = "# kind: waveform\ntime_s,drive_V,response_um", (time, drive, 0.1 * drive)
    (log,) = read_logs(save(table(head, columns, [0, 1, 3999])))
    assert "3 of 4000 rows left out" in log.notes[0]
    refused(save(table(head, columns, [2000])), "line 2003", "'response_um'", "evenly")


def test_each_experiment_of_a_file_is_looked_at_alone(save):
    rows = "".join(f"{k},{line}\n" for k in "ab" for line in sweep([7] if k == "a" else []).splitlines()[1:])
    first, second = read_logs(save("log,frequency_Hz,wd_um,wq_um\n" + rows))
    assert (len(first), len(second)) == (200, 201)
    assert "1 of 201 rows left out" in first.notes[0] and not second.notes
