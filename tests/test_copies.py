"""A log that is there twice counts once: the same rows, exported anew in another order or with fewer
digits."""

import numpy as np
import pytest
import reference

import sysid
from sysid.logs.read import read_logs

PLANT = reference.Plant(G=0.02, tau=1.6e-3, f0=32300.0, k_T=0.0)
HEAD = "# voltage_V: 50\n# temperature_degC: 24\nfrequency_Hz,wd_{0},wq_{0}\n"


def sweep(seed=0, level=0.004, rows=81):
    """Rows (n, 3) of settled points across the resonance, in um."""
    rng, f = np.random.default_rng(seed), np.linspace(31900.0, 32700.0, rows)
    w, w0 = 2 * np.pi * f, 2 * np.pi * PLANT.f0
    z = 50.0 * PLANT.G * 2j * w0 / PLANT.tau / (w0**2 - w**2 + 2j * w / PLANT.tau)
    z = z + level * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    return np.column_stack([f, z.real, z.imag])


def text(rows, form="{:.9g}", unit="um"):
    return HEAD.format(unit) + "".join(
        f"{f:.9g},{form.format(d)},{form.format(q)}\n" for f, d, q in rows.tolist()
    )


WAYS = {
    "fewer decimals, reversed": lambda rows: text(rows[::-1], "{:.4f}"),
    "fewer digits, shuffled": lambda rows: text(np.random.default_rng(9).permutation(rows), "{:.3g}"),
    "in nanometres": lambda rows: text(rows * [1, 1e3, 1e3], "{:.1f}", "nm"),
    "all digits, reversed": lambda rows: text(rows[::-1]),
    "rounded frequencies": lambda rows: text(
        np.column_stack([np.rint(rows[:, 0]), rows[:, 1:]])[::-1], "{:.5f}"
    ),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("last", [True, False])
def test_a_copy_counts_once(save, way, last):
    rows = sweep()
    rows[:, 0] += 0.25  # which the last of them rounds away
    first, copy = save(text(rows)), save(way(rows), "copy.csv")
    logs = read_logs([first, copy] if last else [copy, first])
    (log,) = logs
    other = copy if log.name == "log.csv" else first
    assert log.notes[-1].startswith(f"{other} holds the same rows") and "counted once" in log.notes[-1]
    if way is not WAYS["all digits, reversed"]:
        assert log.name == "log.csv" and "with fewer digits" in log.notes[-1]
        np.testing.assert_allclose(log.frequency, rows[:, 0], rtol=1e-8)
    alone, together = sysid.fit(read_logs(first)), sysid.fit(logs)
    for name in ("tau", "f0"):
        assert together.parameters[name].std == pytest.approx(alone.parameters[name].std, rel=0.02)


def test_a_step_that_is_exported_twice_counts_once(save):
    time = np.arange(120) / 1e4
    drive = np.where(time < 2e-3, 0.0, 100.0)
    at = np.full(120, 32310.0)
    rng = np.random.default_rng(0)
    z = reference.ringing(PLANT, time, drive, at, np.full(120, 24.0))
    z = z + 0.01 * (rng.standard_normal(120) + 1j * rng.standard_normal(120))
    head = "time_s,voltage_V,frequency_Hz,wd_um,wq_um\n"
    rows = np.column_stack([time, drive, at, z.real, z.imag]).tolist()
    files = [
        save(head + "".join(f"{t:.4f},{v:g},{f:g},{d:{form}},{q:{form}}\n" for t, v, f, d, q in rows), name)
        for name, form in (("a.csv", ".3f"), ("b.csv", ".8f"))
    ]
    (log,) = read_logs(files)
    assert log.name == "b.csv" and log.kind == "transient"


@pytest.mark.parametrize("level", [0.004, 3e-5])
def test_two_recordings_are_two_logs(save, level):
    """Also where their noise is a third of the digits that both are written with."""
    files = [save(text(sweep(seed, level), "{:.4f}"), f"{seed}.csv") for seed in (0, 1)]
    assert [log.notes for log in read_logs(files)] == [(), ()]


def test_rows_at_another_drive_are_another_log(save):
    """Of a plate that does not respond to it any more, say: all else is the same."""
    first, second = save(text(sweep())), save(text(sweep()).replace("V: 50", "V: 60"), "other.csv")
    assert len(read_logs([first, second])) == 2
    assert len(read_logs([save(text(sweep(rows=9))), save(text(sweep(rows=9), "{:.4f}"), "few.csv")])) == 2
