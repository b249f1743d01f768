"""The screen and the report: what an engineer reads, and that no name of a file or log can do more than be read."""

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import standin
from matplotlib.image import imread

import controller
from sysid.command import outputs
from sysid.report import costs, html, plots, screen, text
from sysid.verdict.result import Result

HOSTILE = "</script><img src=x onerror=alert(1)>[bold red]:warning:$\\frac{\x1b[2J\u202e\udcff温.csv"


def document(posterior, warnings=(), method="pi"):
    loop = controller.design(posterior, method=method) if posterior.result is Result.successful else None
    content = outputs.document(posterior, loop and controller.as_dict(loop), warnings)
    return content | {"files": {"report.html": "", "posterior.nc": ""}}


def shown(posterior, folder="identified", warnings=()):
    content, file = document(posterior, warnings), io.StringIO()
    screen.show(content, text.derived(posterior.draws, content["parameters"]), Path(folder), file)
    return file.getvalue()


def rendered(posterior, warnings=()):
    return html.render(document(posterior, warnings), posterior)


@pytest.mark.parametrize(
    ("value", "std", "unit", "expected"),
    [
        (0.02000123, 4.94e-5, "um/V", ("0.020001", "0.000049", "um/V")),
        (1.669032e-3, 7.14e-6, "s", ("1.6690", "0.0071", "ms")),
        (32300.2831, 0.455, "Hz", ("32300.28", "0.46", "Hz")),
        (-10.1291, 0.0366, "Hz/degC", ("-10.129", "0.037", "Hz/degC")),
        (4999999.0, 250.0, "Hz", ("4999999", "250", "Hz")),
        (3.1e-9, 2.2e-11, "m/s/V", ("3.100e-9", "0.022e-9", "m/s/V")),
        (61.3, 0.0996, "s", ("61.30", "0.10", "s")),
        (2.5e-7, 1e-9, "s", ("250.0", "1.0", "ns")),
        (0.0, 0.0, "1", ("0.000000", "0.000000", "1")),
    ],
)
def test_numbers_show_two_digits_of_their_error(value, std, unit, expected):
    numbers, given = text.measured(value, std, unit=unit)
    assert (*numbers, given) == expected


def test_derived_quantities_come_from_the_draws():
    posterior = standin.posterior()
    found = text.derived(posterior.draws, document(posterior)["parameters"])
    # Q = pi f0 tau: its relative error is tau's (f0's is 1e-5). 400 draws tell a mean to 5 % and an error to 4 % of itself.
    assert found["Q"]["value"] == pytest.approx(np.pi * 32300 * 1.669e-3, rel=1e-3)
    assert found["Q"]["std"] == pytest.approx(found["Q"]["value"] * 7e-6 / 1.669e-3, rel=0.15)
    assert found["half bandwidth"]["value"] == pytest.approx(1 / (2 * np.pi * 1.669e-3), rel=1e-3)
    without = standin.posterior(missing=("f0",))
    assert set(text.derived(without.draws, document(without)["parameters"])) == {"half bandwidth"}


def test_the_screen_says_all_that_was_promised():
    step = standin.fitted(notes=("column x is kept out of the fit",))
    screenful = shown(standin.posterior([step, standin.fitted("b.csv", "steady")]))
    for words in ("step.csv  transient", "b.csv     steady", "32000 to 32500 Hz", "1.25%"):
        assert words in screenful, words
    for words in ("um/V", "95 % interval", "not determined", "half bandwidth"):
        assert words in screenful, words
    assert screenful.startswith("successful: G, tau and f0 are determined from 2 logs; k_T is not\n")
    for words in ("cannot tell k_T; record more", "Kp ", "tracker ", "fit.json", "column x is kept out"):
        assert words in screenful, words
    assert max(map(len, screenful.splitlines())) <= screen.WIDTH


def test_the_report_shows_what_the_plants_spread():
    content = document(standin.posterior())
    rows = {name: cells for name, *cells in text.promised(content["controller"])}
    promise = content["controller"]["promise"]
    assert rows["gain margin"] == [f"{v:.3g}" for v in (*promise["quantiles_5_50_95"]["gain_margin"], promise["gain_margin"])]
    assert rows["settling to 5 %"][-1] == f"{1e3 * promise['settling_s']:.3g} ms"
    page = html.render(content, standin.posterior())
    assert "kept by 99 %" in page and 'alt="Step response of the closed loop"' in page
    undone = {"gain_margin": None, "quantiles_5_50_95": promise["quantiles_5_50_95"] | {"gain_margin": [None] * 3}}
    assert ["gain margin", *["none"] * 4] in text.promised({"promise": promise | undone})


def test_the_report_says_which_stage_is_checked_and_how():
    words = " ".join(rendered(standin.posterior()).split())
    assert "A record of the stage full, begun at rest, is judged by <code>identify --check FILE -o DIR</code>" in words
    assert '<td class="keep">full<td>' in words


def test_fourteen_logs_fit_on_one_screen():
    logs = [standin.fitted(f"log_with_a_long_name_{i}.csv") for i in range(14)]
    assert len(shown(standin.posterior(logs)).splitlines()) <= 45


def test_a_failure_names_itself_and_what_to_record():
    posterior = standin.posterior(result=Result.undetermined, missing=("G", "f0"))
    said, page = shown(posterior), rendered(posterior)
    for words in (Result.undetermined.value, "cannot tell G; record more"):
        assert words in said and words in page, words
    assert "no controller" in said and "None was designed" in page


def test_draws_without_bounds_are_not_drawn_and_unknown_numbers_say_so():
    modes = ({"value": 1.0, "std": float("inf"), "weight": 0.5}, {"value": 2.0, "std": 0.1, "weight": 0.5})
    step = standin.fitted()
    step.nrmse_percent = step.noise_std = float("nan")
    posterior = standin.posterior([step], result=Result.undetermined, missing=("G", "tau", "f0"), modes=modes)
    posterior.draws["tau"] = np.full((4, 100), np.inf)
    posterior.draws["G"] = np.ones((4, 100))
    posterior.fit.parameters["tau"] = posterior.fit.parameters["f0"].__class__(None, None, None, "s", False, "too short")
    said, page = shown(posterior), rendered(posterior)
    for words in ("1 ± unknown (weight 0.5)", "2 ± 0.1 (weight 0.5)", "too short", "unknown"):
        assert words in said and words in page, words


def test_every_result_has_advice():
    assert set(text.ADVICE) == {result.value for result in Result} - {"successful"}


def test_hostile_names_are_text_on_the_screen():
    log = standin.fitted(HOSTILE, notes=(f"column {HOSTILE} is kept out",), response_unit="u\x1b[1mm")
    screenful = shown(standin.posterior([log]), folder=f"a{HOSTILE}", warnings=[HOSTILE])
    assert not [c for c in screenful if not c.isprintable() and c != "\n"]
    flat = "".join(screenful.split())
    assert "[boldred]:warning:" in flat and "\\u001b[2J\\u202e\\udcff" in flat
    screenful.encode()  # no lone surrogate is left, which a terminal could not take


class Page(HTMLParser):
    """Tags and attributes of a page."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.attributes = [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += attributes


def test_hostile_names_are_text_in_the_report():
    log = standin.fitted(HOSTILE, notes=(f"column {HOSTILE} is kept out",))
    page = rendered(standin.posterior([log]), [HOSTILE])
    parsed = Page(page)
    assert "script" not in parsed.tags and not [name for name, _ in parsed.attributes if name.startswith("on")]
    sources = [value for name, value in parsed.attributes if name == "src"]
    assert len(sources) == 6 and all(source.startswith("data:image/png;base64,") for source in sources)
    assert "&lt;/script&gt;" in page and "\x1b" not in page
    page.encode()


def test_the_report_asks_for_nothing_else():
    page = rendered(standin.posterior())
    assert not re.search(r"https?:|//[a-z]|@import|url\(", re.sub(r"base64,[^\"]*", "", page))
    assert "default-src 'none'" in page
    for words in ("0.0200", "32300.", "cannot tell k_T", "Kp ", "prefers-color-scheme: dark", "emcee", "step.csv", "0" * 64):
        assert words in page, words


def test_the_same_inputs_give_the_same_report():
    assert rendered(standin.posterior()) == rendered(standin.posterior())


@pytest.mark.parametrize(
    ("logs", "titles"),
    [
        ([standin.fitted()], ["Over time"]),
        ([standin.fitted(amplitude_only=True)], ["Over time"]),
        ([standin.fitted(rows=30_000)], ["Over time"]),
        ([standin.fitted("s.csv", "steady")], ["Sweeps"]),
        ([standin.fitted("s.csv", "steady", amplitude_only=True), standin.fitted()], ["Over time", "Sweeps"]),
        ([standin.fitted("p.csv", "steady", frequency=np.full(50, 3e4), drive=np.arange(50.0))], ["Over time"]),
        ([standin.fitted("p.csv", "steady", frequency=None)], ["Over time"]),
        ([standin.fitted(f"{i}.csv", rows=3) for i in range(17)], ["Over time"]),
    ],
    ids=["step", "amplitude", "long", "sweep", "both", "levels", "one level", "many"],
)
def test_every_kind_of_log_is_drawn(logs, titles):
    posterior = standin.posterior(logs)
    images = plots.log_figures(posterior.fit) | plots.posterior_figure(posterior, document(posterior)["parameters"])
    assert list(images) == [*titles, "Residuals, in units of the noise", "Posterior"]
    for png in images.values():
        pixels = imread(io.BytesIO(png))[..., :3]
        assert pixels.std() > 0.01, "an empty image"
        assert b"Software" not in png and b"tEXt" not in png


def test_a_figure_shows_points_and_fit_where_they_are():
    figure = plots._panels([(1, standin.fitted())])
    recorded, model = figure.axes[0].lines[:2]
    log = standin.fitted()
    np.testing.assert_array_equal(recorded.get_ydata(), log.log.response.real)
    np.testing.assert_array_equal(model.get_ydata(), log.response.real)
    # 20 ms of log, drawn in ms; rounding only
    assert model.get_xdata()[-1] == pytest.approx(20.0, rel=1e-12)


def test_images_travel_whole():
    posterior = standin.posterior()
    content = document(posterior)
    images = plots.log_figures(posterior.fit) | plots.posterior_figure(posterior, content["parameters"])
    images |= plots.step_figure(content["controller"]) | costs.ladder_figure(content["uncertainty"]["rungs"])
    found = re.findall(r'base64,([^"]+)"', rendered(posterior))
    assert [base64.b64decode(image) for image in found] == list(images.values())


@pytest.mark.parametrize(
    ("method", "law", "tracker"),
    [
        ("pi", "Kp", "Hz per Wq/Wd"),
        ("pll", "Kp", "Hz per Wq/Wd"),
        ("paper", "Kp", "10 Hz up or down, by the sign of Wq"),
        ("adaptive", "K ", "the observer estimates"),
    ],
)
def test_every_controller_that_a_rig_may_choose_can_be_told(method, law, tracker):
    """Of `paper` and `adaptive` the report stopped with an error: they have other numbers."""
    posterior = standin.posterior()
    content = document(posterior, method=method)
    first, second, *_ = text.gains(content["controller"])
    assert first.startswith(law) and tracker in second
    assert first in html.render(content, posterior).replace("&#39;", "'")
