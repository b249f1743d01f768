"""The screen and the report: what an engineer reads, and that no name of a file or log can do more than be
read."""

import base64
import io
import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import standin
from conftest import study
from matplotlib.image import imread

import controller
from sysid.command import outputs
from sysid.effects.number import Number
from sysid.report import canvas, html, logplots, plots, residualplots, screen, text
from sysid.verdict.finding import Finding
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


@cache
def plain():
    """The report of the posterior that everyone knows."""
    return rendered(standin.posterior())


@cache
def known():
    """The loop and the figures of that report."""
    content = document(posterior := standin.posterior())
    return content["controller"], html.pictured(content, posterior)


def worded(posterior, warnings=()):
    """A report for its words: loop and figures, which take nearly all of its time, are those of the plain
    one."""
    loop, figures = known()
    loop = loop if posterior.result is Result.successful else None
    content = outputs.document(posterior, loop, warnings) | {"files": {"report.html": "", "posterior.nc": ""}}
    return html.render(content, posterior, figures)


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
    # Q = pi f0 tau: its relative error is tau's (f0's is 1e-5). 400 draws tell a mean to 5 % and an error to
    # 4 % of itself.
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
    assert rows["gain margin"] == [
        f"{v:.3g}" for v in (*promise["quantiles_5_50_95"]["gain_margin"], promise["gain_margin"])
    ]
    assert rows["settling to 5 %"][-1] == f"{1e3 * promise['settling_s']:.3g} ms"
    page = html.render(content, standin.posterior())
    assert "kept by 99 %" in page and "<h3>Step response, open and closed loop</h3>" in page
    undone = {
        "gain_margin": None,
        "quantiles_5_50_95": promise["quantiles_5_50_95"] | {"gain_margin": [None] * 3},
    }
    assert ["gain margin", *["none"] * 4] in text.promised({"promise": promise | undone})


def test_the_report_says_which_stage_is_checked_and_how():
    words = " ".join(plain().split())
    assert (
        "A record of the stage full, begun at rest, is judged by <code>identify --check FILE -o DIR</code>"
        in words
    )
    assert '<th scope="row">full<td' in words


def test_fourteen_logs_fit_on_one_screen():
    logs = [standin.fitted(f"log_with_a_long_name_{i}.csv") for i in range(14)]
    assert len(shown(standin.posterior(logs)).splitlines()) <= 45


def test_a_failure_names_itself_and_what_to_record():
    posterior = standin.posterior(result=Result.undetermined, missing=("G", "f0"))
    said, page = shown(posterior), rendered(posterior)
    for words in (Result.undetermined.value, "cannot tell G; record more"):
        assert words in said and words in page, words
    assert "no controller" in said and "None was designed" in page
    assert "value, not to be used" in said and "not to be used" not in shown(standin.posterior())


def test_draws_without_bounds_are_not_drawn_and_unknown_numbers_say_so():
    modes = ({"value": 1.0, "std": float("inf"), "weight": 0.5}, {"value": 2.0, "std": 0.1, "weight": 0.5})
    step = standin.fitted()
    step.nrmse_percent = step.noise_std = float("nan")
    posterior = standin.posterior([step], result=Result.undetermined, missing=("G", "tau", "f0"), modes=modes)
    posterior.draws["tau"] = np.full((4, 100), np.inf)
    posterior.draws["G"] = np.ones((4, 100))
    posterior.fit.parameters["tau"] = posterior.fit.parameters["f0"].__class__(
        None, None, None, "s", False, "too short"
    )
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
    assert not {"script", "img", "style"} & set(parsed.tags[parsed.tags.index("body") :])
    assert not [name for name, _ in parsed.attributes if name.startswith("on")]
    links = [value for name, value in parsed.attributes if name in ("src", "href", "xlink:href")]
    assert links and all(link.startswith(("data:image/png;base64,", "#")) for link in links)
    assert "&lt;/script&gt;" in page and "\x1b" not in page
    page.encode()


def test_the_report_asks_for_nothing_else():
    page = plain()
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", re.sub(r"base64,[^\"]*", "", page))
    assert "default-src 'none'" in page
    for words in (
        "0.0200",
        "32300.",
        "cannot tell k_T",
        "Kp ",
        "prefers-color-scheme: dark",
        "emcee",
        "step.csv",
        "0" * 64,
    ):
        assert words in page, words


@pytest.mark.study
def test_the_same_inputs_give_the_same_report():
    assert plain() == rendered(standin.posterior())


# --- the verdict and the order of things ---


@pytest.mark.parametrize(
    ("dates", "said"),
    [
        (["2026-03-05", ""], " of 2026-03-05"),
        (["2026-03-05 12:00", "2026-03-05 13:30"], " of 2026-03-05"),
        (["2026-03-07", "2026-03-05"], " of 2026-03-05 to 2026-03-07"),
        (["Fri Apr 03 2015", ""], " of Fri Apr 03 2015"),
        (["03/04/2026", "04/03/2026"], ""),
        (["", ""], ""),
    ],
)
def test_the_verdict_names_plate_logs_and_their_dates(dates, said):
    logs = [
        standin.fitted(f"{k}.csv", metadata={"plate": "A7", "Date": date}) for k, date in enumerate(dates)
    ]
    page = worded(standin.posterior(logs))
    told = f"G, tau and f0 of plate A7 are determined from 2 logs{said}; k_T is not"
    assert f"<strong>Successful:</strong> {told}. Next: " in page and "<h1>Plate A7</h1>" in page


def test_the_verdict_says_what_to_do_next():
    after = "commission the controller, then record what k_T asks for, if needed."
    assert f"Next: {after}" in plain()
    assert f"Next: read the 2 warnings, then {after}" in worded(standin.posterior(), ["one", "two"])
    failed = worded(standin.posterior(result=Result.misfit))
    assert (
        f"<strong>Failed:</strong> 2 logs: {Result.misfit.value}: {text.ADVICE[Result.misfit.value]}"
        in failed
    )


def test_values_of_a_failed_fit_are_greyed_and_marked():
    good, bad = plain(), rendered(standin.posterior(result=Result.misfit))
    assert 'class="void"' not in good and "not to be used" not in good.replace("are not to be used", "")
    rows = re.findall(r'<tr class="void">.*?</tr>', bad, re.DOTALL)
    assert len(rows) == 5 and all("not to be used" in row for row in rows)  # G, tau, f0, Q, half bandwidth


def test_figures_and_warnings_stand_before_the_commissioning_sheet():
    page = worded(standin.posterior(), ["mind this"])
    order = [
        "<h1>",
        "Parameters",
        "mind this",
        "<svg",
        "<h2>Controller",
        "<h2>Commissioning",
        "Files and versions",
    ]
    places = [page.index(words) for words in order]
    assert places == sorted(places)
    assert page.index("0" * 64) > page.index("<summary>Files and versions")


def test_warnings_of_many_logs_are_told_once():
    logs = [standin.fitted(f"run {k}.csv") for k in range(12)]
    content = document(
        standin.posterior(logs),
        [*(f"run {k}.csv: no temperature" for k in range(11)), "run 11.csv: late", "all"],
    )
    assert text.gathered(content) == [
        "11 logs (run 0.csv, run 1.csv and 9 more): no temperature",
        "run 11.csv: late",
        "all",
    ]


def test_effects_that_are_fitted_stand_beside_the_parameters():
    posterior = standin.posterior()
    numbers = {"delay_s": Number(2.979e-4, 5.7e-6, "s"), "in_phase": Number(0.09, 0.01, "of the response")}
    posterior.fit.findings = (
        Finding("delay", "fitted", "a.csv: it is late", ("a.csv",), numbers, 3473.4),
        Finding("unseen", "noted", "a doubt"),
    )
    page = worded(posterior)
    cells = re.findall(r'aria-label="Effects that are fitted">.*?</table>', page, re.DOTALL)[0]
    rows = [
        re.findall(r"<t[hd][^>]*>([^<]*)", line)
        for line in cells.splitlines()
        if line.startswith('<tr><th scope="row')
    ]
    assert rows == [
        ["delay", "297.9 ± 5.7 us", "a.csv", "3.47e+03"],
        ["delay, in phase", "0.090 ± 0.010 of the response", "a.csv", "3.47e+03"],
    ]
    assert "Effects that are fitted" not in plain()


def test_a_table_of_many_logs_is_folded():
    few, many = (
        worded(standin.posterior([standin.fitted(f"{k}.csv", rows=9) for k in range(n)])) for n in (14, 60)
    )
    assert '<details class="all" open>' in few and '<details class="all" open>' not in many


# --- figures ---


def drawn(posterior):
    return [
        *plots.fit_figures(posterior.fit),
        *canvas.drawn(plots.of_posterior(posterior, document(posterior)["parameters"])),
    ]


def dots(svg):
    """The images within an SVG, as arrays of RGBA."""
    return [imread(io.BytesIO(base64.b64decode(image))) for image in re.findall(r'base64,([^"]+)"', svg)]


@pytest.mark.parametrize(
    ("logs", "titles"),
    [
        ([standin.fitted()], ["Over time"]),
        ([standin.fitted(amplitude_only=True)], ["Over time"]),
        study([standin.fitted(rows=30_000)], ["Over time"]),
        ([standin.fitted("s.csv", "steady")], ["Sweeps"]),
        ([standin.fitted("s.csv", "steady", amplitude_only=True), standin.fitted()], ["Over time", "Sweeps"]),
        study(
            [standin.fitted(f"{i}.csv", "steady", temperature=np.full(50, 20.0 + i)) for i in range(9)],
            ["Sweeps"],
        ),
        study(
            [standin.fitted("p.csv", "steady", frequency=np.full(50, 3e4), drive=np.arange(50.0))],
            ["Over time"],
        ),
        ([standin.fitted("p.csv", "steady", frequency=None)], ["Over time"]),
        study(
            [standin.fitted(f"{i}.csv", rows=9, nrmse=float(i)) for i in range(17)],
            [
                "Over time: logs 6, 7, 8 and 9",
                "Over time: logs 10, 11, 12 and 13",
                "Over time: logs 14, 15, 16 and 17",
            ],
        ),
    ],
    ids=["step", "amplitude", "long", "sweep", "both", "many sweeps", "levels", "one level", "many"],
)
def test_every_kind_of_log_is_drawn(logs, titles):
    figures = drawn(standin.posterior(logs))
    left = ["Residuals, in units of the noise", "Correlation of the residuals"]
    assert [f.title for f in figures] == [*titles, *left, "Posterior"]
    for figure in figures:
        assert len(figure.svg) < 150_000 and figure.seen.endswith(".") and figure.title not in figure.seen
        assert all(image[..., 3].max() > 0.3 for image in dots(figure.svg)), "an empty image"
    assert all(dots(f.svg) for f in figures if f.title != left[1])


def test_a_figure_shows_points_and_fit_where_they_are():
    figure = logplots._panels([(1, standin.fitted())])
    recorded, model = figure.axes[0].lines[:2]
    log = standin.fitted()
    np.testing.assert_array_equal(recorded.get_ydata(), log.log.response.real)
    np.testing.assert_array_equal(model.get_ydata(), log.response.real)
    # 20 ms of log, drawn in ms; rounding only
    assert model.get_xdata()[-1] == pytest.approx(20.0, rel=1e-12)


def test_texts_of_a_figure_stay_as_they_are():
    """Numbers of paths are shortened and colours become variables, but not those that are texts."""
    figure = canvas.blank(3, 2)
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color=canvas.BLUE)
    axes.set_xticks([0.0, 0.12345], ["0.00012345", "#0072b2.csv"])
    picture = canvas.Picture("a", lambda: figure, lambda: "")
    (found,) = canvas.drawn([picture])
    assert ">0.00012345<" in found.svg and ">#0072b2.csv<" in found.svg
    assert (
        "stroke: var(--blue)" in found.svg
        and "#0072b2;" not in found.svg
        and not re.search(r'd="[^"]*\.\d{3}', found.svg)
    )


def test_parts_of_figures_do_not_meet_on_the_page():
    """What is referred to is there once; nothing else has a name."""
    page = rendered(standin.posterior([standin.fitted(f"{k}.csv") for k in range(9)]))
    names = re.findall(r' id="([^"]+)"', page)
    wanted = set(re.findall(r'xlink:href="#([^"]+)"|url\(#([^)]+)\)', page))
    assert len(names) == len(set(names)) and set(names) == {a or b for a, b in wanted}


@pytest.mark.study
def test_an_alternative_text_says_what_is_seen():
    logs = [standin.fitted(), standin.fitted("sweep.csv", "steady", 60)]
    seen = {f.title: f.seen for f in drawn(standin.posterior(logs))}
    assert "1  step.csv over 0 to 20 ms, |W| up to 1.0" in seen["Over time"]
    assert "1.2 % of it left by the fit" in seen["Over time"]
    assert "One sweep from 32000 to 32500 Hz" in seen["Sweeps"]
    assert "of 220 residuals lie within 1.96" in seen["Residuals, in units of the noise"]
    page = rendered(standin.posterior(logs))
    assert all(f'role="img" aria-label="{words}"' in page for words in seen.values())


def test_correlation_is_told_in_its_standard_errors():
    """Of white noise, and of noise whose correlation is known, it is normal of standard deviation 1; else it
    stands out."""
    rng = np.random.default_rng(4)
    shared = np.zeros((2000, 2))
    shared[0] = rng.standard_normal(2)
    for k, e in enumerate(rng.standard_normal((1999, 2)), 1):
        shared[k] = 0.6 * shared[k - 1] + 0.8 * e  # variance 1
    white = rng.standard_normal((2000, 2))
    log = standin.fitted(rows=2000)
    step = 0.02 / 1999

    def found(noise, time=0.0):
        log.residual, log.noise_std, log.noise_time = noise @ [1, 1j], 1.0, time
        return residualplots.correlation(log)

    # 20 numbers tell a standard deviation to 16 % of itself: 3.5 of these
    for values in (found(white), found(shared, step / -np.log(0.6))):
        assert 0.44 < np.sqrt(np.mean(values**2)) < 1.56
    # 0.6 of neighbours among 4000 numbers, to three of its errors
    assert found(shared)[0] == pytest.approx(0.6 * np.sqrt(4000), abs=3)


@pytest.mark.parametrize(
    ("method", "law", "tracker"),
    [
        study("pi", "Kp", "Hz per Wq/Wd"),
        study("pll", "Kp", "Hz per Wq/Wd"),
        study("paper", "Kp", "10 Hz up or down, by the sign of Wq"),
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
