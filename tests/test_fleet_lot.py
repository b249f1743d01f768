"""Plates that are not like the others of a lot: tables drawn from known lots, whose odd plates are known."""

import base64
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from conftest import study, tiers
from scipy import stats

from sysid.fleet import words
from sysid.fleet.halves import halves
from sysid.fleet.lot import ALARMS, judged
from sysid.fleet.odd import with_odd
from sysid.fleet.page import render
from sysid.fleet.robust import lot
from sysid.fleet.tails import tails

MIDDLE, SIZE = np.array([np.log(0.02), np.log(1.67e-3), 32300.0]), np.array([0.1, 0.1, 20.0])
ERRORS = np.array([0.003, 0.0045, 0.45])  # of a fit of a step and a sweep


def table(places, errors=ERRORS, seed=0, **columns):
    """The table of plates at `places` (n, 3) of ln G, ln tau, f0, of which fits know each to `errors`."""
    rng = np.random.default_rng([9, seed])
    n = len(places)
    errors = np.broadcast_to(errors, places.shape)
    found = places + errors * rng.standard_normal(places.shape)
    frame = pd.DataFrame(
        {"plate": [f"P{k}" for k in range(n)], "result": "successful", "error": None, "date": None}
    )
    frame["warnings"], frame["logs"], frame["findings"] = [[]] * n, [[]] * n, [[]] * n
    frame["serial"], frame["reference_temperature_degC"], frame["way_why"] = np.nan, 24.0, ""
    for k, (name, unit) in enumerate((("G", "um/V"), ("tau", "s"), ("f0", "Hz"))):
        frame[name] = np.exp(found[:, k]) if k < 2 else found[:, k]
        frame[f"{name}_std"] = errors[:, k] * (frame[name] if k < 2 else 1.0)
        frame[f"{name}_unit"], frame[f"{name}_determined"] = unit, True
    frame["k_T"], frame["k_T_std"], frame["k_T_unit"], frame["k_T_determined"] = (
        np.nan,
        np.nan,
        "Hz/degC",
        False,
    )
    return frame.assign(**columns)


def drawn(rng, n, correlation=None):
    """(n, 3) plates of the lot."""
    root = np.linalg.cholesky(np.eye(3) if correlation is None else correlation)
    return MIDDLE + SIZE * (rng.standard_normal((n, 3)) @ root.T)


@pytest.mark.parametrize("lots", tiers(6, 200))
def test_at_most_one_false_alarm_in_a_lot_of_a_thousand(lots):
    rng = np.random.default_rng(1)
    alarms = np.array([with_odd(table(drawn(rng, 1000), seed=k))[0]["odd"].sum() for k in range(lots)])
    assert alarms.sum() <= stats.poisson.ppf(0.999, ALARMS * lots)
    assert np.mean(alarms > 1) <= 0.05 + 2 / lots


@pytest.mark.parametrize("lots", tiers(4, 40))
def test_plates_at_sixty_percent_are_found(lots):
    rng, found, alarms = np.random.default_rng(2), [], []
    for k in range(lots):
        places = drawn(rng, 1000)
        places[:20, :2] += np.log(0.6)
        odd = with_odd(table(places, seed=k))[0]["odd"].to_numpy()
        found.append(odd[:20].mean())
        alarms.append(odd[20:].sum())
    assert np.mean(found) >= 0.95
    assert np.mean(np.array(alarms) > 1) <= 0.05 + 2 / lots


@pytest.mark.parametrize(("correlation", "least", "most"), [(0.0, 0.0, 0.1), (0.95, 0.9, 1.0)])
def test_three_sd_in_f0_show_only_beside_what_goes_with_f0(correlation, least, most):
    # in a thousand plates 2.7 are as far off by chance; where G tells f0, they are not
    rng = np.random.default_rng(3)
    matrix = np.eye(3)
    matrix[0, 2] = matrix[2, 0] = correlation
    places = drawn(rng, 1000, matrix)
    places[:20, 2] += 60.0
    odd = with_odd(table(places))[0]
    assert least <= odd["odd"][:20].mean() <= most
    assert odd["odd"][20:].sum() <= 1
    assert correlation == 0 or any("from where plates of its" in why for why in odd["odd_why"][:20] if why)


def test_the_sentence():
    places = np.array([MIDDLE] * 400) + SIZE * np.random.default_rng(4).standard_normal((400, 3)) * 0.3
    places[7] = MIDDLE + [0.0, np.log(0.61), 80.0]
    row = with_odd(table(places))[0].iloc[7]
    first, second = row["odd_why"].split("; ")
    assert row["odd"]
    assert first.startswith("tau at 0.6") and first.endswith(" sd") and "of the lot's median, 1" in first
    assert second.startswith("f0 8") and "Hz above the lot's median, 1" in second


def test_a_plate_that_its_own_fit_hardly_knows_is_not_odd():
    places = drawn(np.random.default_rng(5), 300)
    places[:2, 1] = MIDDLE[1] + 0.8
    frame = table(places)
    assert list(with_odd(frame)[0]["odd"][:2]) == [True, True]
    frame.loc[0, "tau_std"] = 0.5 * frame.loc[0, "tau"]
    assert list(with_odd(frame)[0]["odd"][:2]) == [False, True]


def test_the_lot_s_own_scatter_is_found_beside_odd_plates_and_errors():
    rng = np.random.default_rng(6)
    shape = np.array([[1.0, 0.6, 0.0], [0.6, 1.0, -0.3], [0.0, -0.3, 1.0]])
    errors = np.exp(0.5 * rng.standard_normal((5000, 3)))  # as large as what they are to be told from
    x = rng.multivariate_normal(np.zeros(3), shape, 5000) + errors * rng.standard_normal((5000, 3))
    x[:500] += 8.0
    x[rng.random((5000, 3)) < 0.1] = np.nan  # not determined
    found = lot(x, np.einsum("ni,ij->nij", errors**2, np.eye(3)))
    np.testing.assert_allclose(found.scatter, shape, atol=0.12)
    np.testing.assert_allclose(found.centre, 0.0, atol=0.1)


def test_distances_are_mahalanobis_s():
    rng = np.random.default_rng(7)
    x, own = rng.standard_normal((60, 2)), np.array([np.diag(d) for d in rng.random((60, 2))])
    found = lot(x, own)
    for k in (0, 11):
        away, total = x[k] - found.centre[0], found.scatter + own[k]
        assert found.distances[k] == pytest.approx(away @ np.linalg.inv(total) @ away)
        given = total[0, 1] / total[1, 1]
        beside = (away[0] - given * away[1]) / np.sqrt(total[0, 0] - given * total[0, 1])
        assert found.beside[k, 0] == pytest.approx(beside)


@pytest.mark.parametrize("n", [10, study(20), study(50)])
def test_few_plates_give_few_alarms(n):
    rng, lots = np.random.default_rng(8), 60
    alarms = [judged(table(drawn(rng, n), seed=k)).odd.sum() for k in range(lots)]
    assert np.sum(alarms) <= stats.poisson.ppf(0.9999, 1.3 * ALARMS * lots)


def test_too_few_plates_are_no_lot():
    frame, found = with_odd(table(drawn(np.random.default_rng(9), 5)))
    assert found is None and not frame["odd"].any() and frame["odd_chance"].isna().all()
    assert "too few" in words.said(frame)[0]


def test_long_tails_are_the_lot_s_own():
    rng = np.random.default_rng(10)
    wild = np.sqrt(5 / rng.chisquare(5, 1000))[:, None]
    places = MIDDLE + (drawn(rng, 1000) - MIDDLE) * wild
    places[:10] = MIDDLE + 40 * SIZE
    frame, found = with_odd(table(places))
    normal = stats.chi2.sf(found.lot.distances, 3) < ALARMS / 1000
    assert normal[10:].sum() > 10  # as a normal lot would be judged
    assert frame["odd"][10:].sum() <= 3 and frame["odd"][:10].all()
    assert 3 <= found.tails.degrees <= 8 and "longer tails" in " ".join(words.said(frame))


def test_tails_are_those_of_student_s_t():
    rng = np.random.default_rng(11)
    distances = 3 * stats.f.rvs(3, 8, size=20_000, random_state=rng)
    assert 6 <= tails(distances, 3).degrees <= 10
    assert tails(stats.chi2.rvs(3, size=20_000, random_state=rng), 3) is None


def test_a_lot_that_drifts_is_judged_beside_its_drift():
    rng = np.random.default_rng(12)
    places = drawn(rng, 500) * 1.0
    places[:, 1] = MIDDLE[1] + 0.02 * rng.standard_normal(500) + np.linspace(0, 0.5, 500)
    places[10, 1] = MIDDLE[1] + 0.4  # as the plates at the end, but at the beginning
    frame, found = with_odd(table(places, serial=np.arange(500.0)))
    assert list(frame["plate"][frame["odd"]]) == ["P10"]
    (drift,) = found.drifts
    assert (drift.parameter, drift.along) == ("tau", "serial number")
    assert drift.change == pytest.approx(np.exp(0.5), rel=0.02)
    assert any(line.startswith("tau goes by +6") for line in words.said(frame))


def test_f0_is_compared_at_one_temperature():
    rng = np.random.default_rng(13)
    warm = rng.uniform(18, 30, 400)
    places = drawn(rng, 400)
    places[:, 2] += -10.0 * (warm - 24)
    places[3, 2] = 32300 - 10.0 * (warm[3] - 24) + 130
    frame, found = with_odd(table(places, reference_temperature_degC=warm))
    assert frame["odd"][3] and frame["odd"].sum() <= 2
    assert found.drifts[0].change == pytest.approx(-10.0 * np.ptp(warm), rel=0.05)


def test_dates_go_before_serial_numbers():
    rng = np.random.default_rng(14)
    places, order = drawn(rng, 300), rng.permutation(300)
    places[:, 2] += 0.5 * order
    dates = [f"2026-01-{1 + k // 24:02d}T{k % 24:02d}:00:00" for k in order]
    (drift,) = judged(table(places, serial=np.arange(300.0), date=dates)).drifts
    assert (drift.parameter, drift.along) == ("f0", "date") and drift.change == pytest.approx(150, rel=0.1)


def test_a_lot_that_is_two():
    rng = np.random.default_rng(15)
    places = drawn(rng, 400)
    places[:80, 1] -= 1.0
    places[99, 1] += 1.2
    frame, _ = with_odd(table(places))
    assert list(frame["group"][:80]) == [2] * 80 and frame["group"][80:].max() == 1
    assert list(frame["plate"][frame["odd"]]) == ["P99"]
    assert any("the lot is two, by tau: 80 plates" in line for line in words.said(frame))


@pytest.mark.parametrize("values", ["normal", "even", "t3", "exponential"])
def test_a_lot_that_is_one(values):
    rng = np.random.default_rng(16)
    draw = {"normal": rng.standard_normal, "even": rng.random, "exponential": rng.standard_exponential}
    draw["t3"] = lambda n: rng.standard_t(3, n)
    assert all(halves(draw[values](500)) is None for _ in range(20))


def test_plates_that_are_not_identified_are_odd_and_do_not_judge():
    places = drawn(np.random.default_rng(17), 100)
    frame = table(places)
    frame.loc[3, ["result", "error"]] = ["the logs cannot be read", "x.csv: found nothing"]
    frame.loc[4, "result"] = "the model does not describe the logs"
    frame.at[4, "warnings"] = ["it is bent", "and more"]
    told = with_odd(frame)[0]
    assert list(told["plate"][told["odd"]]) == ["P3", "P4"]
    assert told["odd_why"][3] == "the logs cannot be read: x.csv: found nothing"
    assert told["odd_why"][4] == "the model does not describe the logs: it is bent"
    assert told["odd_chance"].isna().sum() == 2


def test_what_few_plates_show_makes_them_odd():
    def shows(key, evidence, outcome="fitted"):
        return {"key": key, "outcome": outcome, "evidence": evidence, "sentence": f"it has {key}"}

    frame = table(drawn(np.random.default_rng(21), 100))
    frame["findings"] = [[shows("filter", 90.0)] for _ in range(100)]  # the bench of the whole lot
    frame.at[5, "findings"] = [shows("duffing", 30.0)]
    frame.at[6, "findings"] = [shows("second_mode", 5.5)]  # as by chance in one plate of 245
    frame.at[7, "findings"] = [shows("drift", 30.0, "noted")]
    told = with_odd(frame)[0]
    assert list(told["plate"][told["odd"]]) == ["P5"]
    assert told["odd_why"][5] == "it has duffing (so in 1 of 100 plates)"


def test_units_of_g_are_made_one():
    frame = table(drawn(np.random.default_rng(18), 100))
    frame.loc[:20, ["G", "G_std"]] *= 1000
    frame.loc[:20, "G_unit"] = "nm/V"
    assert not with_odd(frame)[0]["odd"].any()


def test_the_page_has_the_odd_plates_first_and_asks_for_nothing(tmp_path):
    rng = np.random.default_rng(22)
    places = drawn(rng, 60)
    places[7, :2] += np.log(0.3)
    frame = table(places, serial=np.arange(60.0))
    frame.loc[3, ["result", "error"]] = ["the logs cannot be read", "<b>x.csv</b>: found nothing"]
    frame.loc[9, "plate"] = "<script>alert(1)</script>"
    frame, found = with_odd(frame)
    trace = {
        "name": "s.csv",
        "label": "s",
        "unit": "um",
        "x": [0.0, 0.1],
        "digit": 0.5,
        "parts": [[[1, 2], [1, 2]], [[0, 1], [0, 1]]],
    }
    rows = [{"traces": [trace]} if k == 7 else {} for k in range(60)]
    page = render(frame, found, rows, "plates")
    first, second = page.index("tau at 0."), page.index("found nothing")
    assert first < second < page.index("Distributions") < page.index("All plates")
    assert "<script" not in page and "<b>" not in page and "&lt;script&gt;" in page
    assert page.count('href="plates/') == 60 and "http" not in page.replace("http-equiv", "")
    sources = re.findall(r'<img alt="([^"]*)" src="data:image/svg\+xml;base64,([^"]*)"', page)
    titles = ["Distributions", "Parameter against parameter", "Along the serial number"]
    assert [title for title, _ in sources] == [
        "plate P7 in its lot, and its logs beside their model",
        *titles,
    ]
    for _, text in sources:
        assert ElementTree.fromstring(base64.b64decode(text)).tag.endswith("svg")
    assert render(frame, found, rows, "plates") == page


def test_warnings_are_said_once():
    frame = table(drawn(np.random.default_rng(19), 3))
    frame["logs"] = [["a/x.csv"], ["b/x.csv"], ["z.csv"]]
    frame["warnings"] = [["x.csv: noise of 3 %"], ["x.csv: noise of 4.5e-3 %"], ["another"]]
    assert words.repeated(frame) == [(2, "noise of # %"), (1, "another")]


def test_noise_that_the_lot_has_is_said_where_chance_does_not_make_it():
    frame, _ = with_odd(table(drawn(np.random.default_rng(9), 40)))
    for count, expected in ((3, 0), (12, 1)):
        frame["way_why"] = ["noise in proportion to the response"] * count + [""] * (40 - count)
        said = [line for line in words.said(frame) if line.startswith("noise in proportion")]
        assert len(said) == expected and all("in 12 plates" in line for line in said)


def test_a_copy_under_another_name_is_told_from_a_plate_that_is_like_another():
    """The numbers of two of a thousand plates are one reading's; the
    nearest two that were drawn are no copies, nor is one whose fit found a further parameter."""
    frame = table(drawn(np.random.default_rng(11), 1000), ERRORS * 1e-3)
    numbers = [f"{name}{end}" for name in ("G", "tau", "f0") for end in ("", "_std")]
    frame.loc[[7, 30], numbers] = frame.loc[[700, 31], numbers].to_numpy()
    frame.loc[30, ["k_T", "k_T_std", "k_T_determined"]] = [-10.0, 0.1, True]
    why = with_odd(frame)[0]["odd_why"]
    assert why[7] == "its readings are those of P700: one of the two is a copy under another name"
    assert why[700].startswith("its readings are those of P7:")
    assert why.str.contains("copy").sum() == 2


def test_a_plate_that_was_measured_in_the_warmth_is_said_to_be():
    """f0 of a plate at 35 degC, 112 Hz below: where others are at 24, that is the first thing to look at; where
    a fifth of the lot is as warm, it is not the plate's own."""
    places = drawn(np.random.default_rng(12), 100)
    places[5, 2] -= 200.0
    warm = np.full(100, 24.0)
    warm[5] = 35.0
    said = with_odd(table(places, reference_temperature_degC=warm))[0]["odd_why"]
    assert said[5].startswith("f0 ") and said[5].endswith("; at 35 degC, where the lot is at 24 degC")
    warm[::5] = 35.0
    said = with_odd(table(places, reference_temperature_degC=warm))[0]["odd_why"]
    assert "degC" not in str(said[5])
