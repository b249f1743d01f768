"""Plates' numbers by their own logs and by the lot: lots drawn with known numbers, and the covariance that
theory leaves, S (S + C)^-1 C."""

import re

import numpy as np
import pytest
from conftest import study, tiers
from test_fleet_lot import SIZE, drawn, table

from sysid.fleet.lot import judged, with_pooled
from sysid.fleet.odd import with_odd
from sysid.fleet.page import render

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
@pytest.mark.parametrize("correlation", [None, study(ALIKE)], ids=["alone", "alike"])
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


def test_the_page_has_them_beside_the_plates_own():
    places = drawn(np.random.default_rng(8), 40)
    places[3, :2] += np.log(0.3)
    frame, found = with_odd(table(places, HARDLY))
    assert "pooled" not in render(frame, found, [{}] * 40, None)
    page = render(with_pooled(frame, found), found, [{}] * 40, None)
    lines = page[page.index("<h2>All plates") :].split("<tr>")[1:]
    cells = [re.findall(r"<t[hd][^>]*>([^<]*)", line) for line in lines]
    assert cells[0] == ["plate", *(f"{name}{end}" for name in NAMES for end in ("", " pooled")), "result"]
    shown = {row[0].strip(): row[1:-1] for row in cells[1:]}
    assert len(shown) == 40 and shown["P3"][1::2] == ["", "", ""]
    own, pooled = (np.array([float(shown[f"P{k}"][j].split()[0]) for k in range(3)]) for j in (4, 5))
    told = with_pooled(frame, found)["f0_pooled"][:3]
    units = [1e3 if "kHz" in shown[f"P{k}"][5] else 1.0 for k in range(3)]
    np.testing.assert_allclose(pooled * units, told, atol=5)
    assert not np.allclose(own, pooled, atol=0)


def by_draws(values, covariances, scatter=None):
    """(mean, std) (n, p) of each plate's numbers by NumPyro's NUTS: a flat centre, the lot's scatter as given,
    or of its own as wide as anything."""
    jax, numpyro = pytest.importorskip("jax"), pytest.importorskip("numpyro")
    from jax import numpy as jnp
    from numpyro import distributions as dist
    from numpyro.infer import MCMC, NUTS

    n, p = values.shape

    def model():
        centre = numpyro.sample("centre", dist.ImproperUniform(dist.constraints.real, (), (p,)).to_event(0))
        if scatter is None:
            width = numpyro.sample("width", dist.HalfNormal(10.0).expand([p]).to_event(1))
            root = width[:, None] * numpyro.sample("root", dist.LKJCholesky(p, 1.0))
        else:
            root = jnp.linalg.cholesky(scatter)
        away = numpyro.sample("away", dist.Normal(0, 1).expand([n, p]).to_event(2))
        places = numpyro.deterministic("places", centre + away @ root.T)
        numpyro.sample("seen", dist.MultivariateNormal(places, covariances), obs=values)

    with jax.enable_x64(True):
        chains = MCMC(NUTS(model), num_warmup=400, num_samples=3000, progress_bar=False)
        chains.run(jax.random.PRNGKey(0))
        places = np.asarray(chains.get_samples()["places"])
    return places.mean(0), places.std(0)


@pytest.mark.study
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("given", [True, False], ids=["scatter given", "scatter of its own"])
def test_numbers_in_closed_form_are_those_of_draws(given):
    """The closed form holds the error of the centre, not that of the scatter, which draws of it have too."""
    frame = table(drawn(np.random.default_rng(9), 24 if given else 60, ALIKE), HARDLY)
    lot = judged(frame).lot
    scaled = lot.values[lot.kept] / SIZE - np.mean(lot.values, axis=0) / SIZE
    size = np.outer(SIZE, SIZE)
    drawn_mean, drawn_std = by_draws(
        scaled, lot.covariances[lot.kept] / size, lot.scatter / size if given else None
    )
    mean = (lot.pooled[0][lot.kept] - np.mean(lot.values, axis=0)) / SIZE
    std = np.sqrt(np.diagonal(lot.pooled[1][lot.kept], axis1=1, axis2=2)) / SIZE
    off = np.sqrt(np.mean(((mean - drawn_mean) / std) ** 2))
    assert off < (0.03 if given else 0.15)
    np.testing.assert_allclose(np.mean(drawn_std / std), 1.0, atol=0.01 if given else 0.08)


def test_of_few_plates_there_is_no_lot():
    frame = pooled(table(drawn(np.random.default_rng(7), 5)))
    assert frame[[f"{name}_pooled" for name in NAMES]].isna().all(axis=None)
