"""Plates' numbers by their own logs and by the lot: lots drawn with known numbers, and the covariance that
theory leaves, S (S + C)^-1 C."""

import numpy as np
import pytest
from conftest import tiers
from test_fleet_lot import SIZE, drawn, table

from sysid.fleet.lot import judged, with_pooled
from sysid.fleet.odd import with_odd

NAMES = ("G", "tau", "f0")
ALIKE = np.array([[1, 0.8, 0], [0.8, 1, 0], [0, 0, 1.0]])
HARDLY = np.array([0.05, 0.1, 20.0])  # errors as large as a lot scatters, or half of that


def pooled(frame):
    whole, found = with_odd(frame)
    return with_pooled(whole, found)


def off(frame, places, end=""):
    """(n, 3) of plates by how much their numbers are off the truth, G and tau in logarithms; and the error
    that the table tells."""
    value = np.column_stack([frame[f"{n}{end}"].to_numpy() for n in NAMES])
    std = np.column_stack([frame[f"{n}{end}_std"].to_numpy() for n in NAMES])
    value[:, :2], std[:, :2] = np.log(value[:, :2]), std[:, :2] / value[:, :2]
    return value - places, std


@pytest.mark.parametrize("lots", tiers(6, 60))
@pytest.mark.parametrize("correlation", [None, ALIKE], ids=["alone", "alike"])
def test_errors_shrink_as_theory_says_and_intervals_hold_the_truth(lots, correlation):
    rng, own, lent, scaled = np.random.default_rng(3), [], [], []
    for k in range(lots):
        places = drawn(rng, 1000, correlation)
        frame = pooled(table(places, HARDLY, seed=k))
        good = ~frame["odd"].to_numpy()
        own.append(off(frame, places)[0][good])
        left, std = off(frame, places, "_pooled")
        lent.append(left[good])
        scaled.append((left / std)[good])
    own, lent, scaled = map(np.concatenate, (own, lent, scaled))
    S, C = np.outer(SIZE, SIZE) * (np.eye(3) if correlation is None else correlation), np.diag(HARDLY**2)
    theory = np.sqrt(np.diag(S @ np.linalg.inv(S + C) @ C)) / HARDLY
    assert np.all(theory < 0.9)
    np.testing.assert_allclose(np.sqrt(np.mean(lent**2, 0) / np.mean(own**2, 0)), theory, rtol=0.03)
    np.testing.assert_allclose(np.mean(np.abs(scaled) < 1.96, axis=0), 0.95, atol=0.012)


def test_what_logs_tell_better_than_the_lot_stays():
    places = drawn(np.random.default_rng(4), 200)
    frame = pooled(table(places, SIZE / 1000))
    for name in NAMES:
        difference = (frame[f"{name}_pooled"] - frame[name]).abs() / frame[f"{name}_std"]
        assert difference.max() < 0.01
        np.testing.assert_allclose(frame[f"{name}_pooled_std"], frame[f"{name}_std"], rtol=1e-4)


def test_own_numbers_stay_and_odd_plates_have_none_of_the_lot():
    places = drawn(np.random.default_rng(5), 300)
    places[:5, :2] += np.log(0.5)
    frame = table(places)
    frame.loc[7, ["G", "G_std"]] *= 1000
    frame.loc[7, "G_unit"] = "nm/V"
    frame.loc[9, "tau_determined"], frame.loc[9, ["tau", "tau_std"]] = False, np.nan
    whole = pooled(frame)
    assert whole[[*frame]].equals(with_odd(frame)[0][[*frame]])
    assert whole["odd"][:5].all() and whole.loc[whole["odd"], "G_pooled"].isna().all()
    assert not whole["odd"][7] and abs(whole["G_pooled"][7] / whole["G"][7] - 1) < 0.01
    assert not whole["odd"][9] and np.isnan(whole["tau_pooled"][9]) and whole["f0_pooled"][9] > 0
    assert not {"k_T_pooled"} & {*whole}


def test_of_a_lot_that_drifts_each_is_drawn_to_where_the_lot_is_there():
    n = 300
    places = drawn(np.random.default_rng(6), n)
    places[:, 2] += np.linspace(0, 200, n)
    frame = table(places, HARDLY, serial=np.arange(n, dtype=float))
    assert judged(frame).drifts
    left = off(pooled(frame), places, "_pooled")[0][:, 2]
    first, last = np.nanmean(left[:100]), np.nanmean(left[-100:])
    assert max(abs(first), abs(last)) < 4 * 15 / 10  # 4 errors of a mean of 100
    assert np.nanstd(left) < 0.8 * HARDLY[2]


def test_of_few_plates_there_is_no_lot():
    frame = pooled(table(drawn(np.random.default_rng(7), 5)))
    assert frame[[f"{name}_pooled" for name in NAMES]].isna().all(axis=None)
