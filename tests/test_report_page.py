"""The report in a browser: on a desk, on a phone, in print and in the dark; nothing is cut, asked for or
complained of.

A Chromium is needed, and playwright to drive it; without them the tests are skipped by name."""

import re
import shutil
from dataclasses import dataclass

import numpy as np
import pytest
import standin
import test_circuit as circuits
from conftest import study
from test_fleet_lot import drawn, table
from test_report import HOSTILE, document, rendered

import sysid
from sysid.command import sets
from sysid.fleet.lot import with_pooled
from sysid.fleet.odd import with_odd
from sysid.fleet.page import render
from sysid.report import html, zoom
from sysid.verdict.result import Result

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
VIEWS = {
    "desk": {"viewport": {"width": 1280, "height": 900}},
    "phone": {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 2, "has_touch": True},
    "dark": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "dark"},
    "print": {"viewport": {"width": 794, "height": 1123}},  # A4
}
OPEN = "for (const part of document.querySelectorAll('details')) part.open = true"
REPORTS = ("fit", "circuit", "controller", "failed", "open", "hostile", "sixty", "lot")
ZOOMABLE = ("controller_zoomable", "hostile_zoomable", "sixty_zoomable")
# What reaches beyond the page to the right; the heads of tables are hidden on a phone, and
# figures to zoom into are moved by themselves.
BEYOND = """[...document.querySelectorAll('body *')].filter(e => !e.closest('svg, thead, .beyond') && e.getClientRects().length
  && e.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map(e => e.outerHTML.slice(0, 100))"""

# Words of tables that go on in a second line; names may be of any length.
BROKEN = """[...document.querySelectorAll('td:not(.name)')].flatMap(cell => [...cell.childNodes])
  .filter(node => node.nodeType === 3).flatMap(node => [...node.data.matchAll(/\\S+/g)].filter(word => {
    const range = document.createRange();
    range.setStart(node, word.index);
    range.setEnd(node, word.index + word[0].length);
    return new Set([...range.getClientRects()].map(box => box.top)).size > 1;
  }).map(word => word[0]))"""


@pytest.fixture(scope="module")
def browser():
    driver = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip("no Chromium is installed")
    with driver.sync_playwright() as run:
        browser = run.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


def lot():
    """The page of a lot of plates, of which one is odd, one failed and one has a name that would do harm."""
    places = drawn(np.random.default_rng(22), 60)
    places[7, :2] += np.log(0.3)
    frame = table(places, serial=np.arange(60.0))
    frame["plate"] = frame["plate"].astype(object)  # as `framed` has names, which may be no text
    frame.loc[3, ["result", "error"]] = ["the logs cannot be read", f"{'x' * 200}.csv: found nothing"]
    frame.loc[9, "plate"] = HOSTILE
    frame.at[11, "warnings"] = [f"{'y' * 200}.csv: {HOSTILE}"]
    frame, found = with_odd(frame)
    parts = [[[1, 2, 3], [1, 2, 2]], [[0, 1, 1], [0, 1, 2]]]
    name = HOSTILE.replace("温", "")  # of which not every machine has a letter to draw
    trace = {"name": name, "label": "s", "unit": "um", "x": [0.0, 0.1, 0.2], "digit": 0.5, "parts": parts}
    rows = [{"traces": [trace] * 3} if k == 7 else {} for k in range(60)]
    return render(with_pooled(frame, found), found, rows, "plates")


class Pages(dict):
    """{name: path}; what is not there is made and written when it is first looked at."""

    def __init__(self, folder, made):
        super().__init__((path.stem, path) for path in folder.glob("*.html"))
        self.folder, self.made = folder, made

    def __missing__(self, name):
        self[name] = path = self.folder / f"{name}.html"
        path.write_text(self.made[name](), encoding="utf-8")
        return path


def zoomable(posterior):
    content = document(posterior)
    return zoom.page(content, html.pictured(content, posterior), "report.html")


@pytest.fixture(scope="module")
def reports(bench, tmp_path_factory):
    """{name: path}: a real fit with its controller, a failed one, names that would do harm, and sixty
    logs."""
    folder = tmp_path_factory.mktemp("reports")
    fit = sysid.fit([bench.sweep(seed=1), bench.sweep(seed=2, temperature=30.0), bench.transient(seed=3)])
    sets.report(fit.posterior, folder / "fit.html", zoomable=True)
    f = circuits.LANGEVIN.sweep()
    analysed = sysid.Log.from_arrays(
        circuits.LANGEVIN.admittance(f, np.random.default_rng(0)) / (2 * np.pi * f),
        drive=1.0,
        frequency=f,
        response_unit="C",
        metadata={"reference_ohm": "50", "device": "one port"},
        relative_noise=True,
    )
    sets.report(sysid.fit(analysed).posterior, folder / "circuit.html")
    many = [
        standin.fitted(f"run_{k}_of_the_second_batch.csv", "steady" if k % 2 else "transient", rows=60)
        for k in range(60)
    ]
    warnings = [f"run_{k}_of_the_second_batch.csv: no temperature is recorded" for k in range(60)]
    harmful = [standin.fitted(HOSTILE), standin.fitted("x" * 200, "steady")]
    made = {
        "controller": lambda: rendered(standin.posterior(), ["a warning"]),
        "failed": lambda: rendered(standin.posterior(result=Result.misfit)),
        "open": lambda: rendered(standin.posterior(result=Result.undetermined, missing=("G", "f0"))),
        "hostile": lambda: rendered(standin.posterior(harmful), [HOSTILE]),
        "sixty": lambda: rendered(standin.posterior(many), warnings),
        "hostile_zoomable": lambda: zoomable(standin.posterior(harmful)),
        "sixty_zoomable": lambda: zoomable(standin.posterior(many)),
        "controller_zoomable": lambda: zoomable(standin.posterior()),
        "lot": lot,
    }
    return Pages(folder, made)


@dataclass
class Seen:
    """A page in one view, with all that it said or asked for."""

    page: object
    complaints: list
    requests: list


@pytest.fixture
def look(browser):
    contexts = []

    def at(path, view):
        contexts.append(browser.new_context(bypass_csp=True, **VIEWS[view]))
        page = contexts[-1].new_page()
        seen = Seen(page, [], [])
        page.on("console", lambda message: seen.complaints.append(message.text))
        page.on("pageerror", lambda error: seen.complaints.append(str(error)))
        page.on("request", lambda request: seen.requests.append(request.url))
        page.on("dialog", lambda dialog: (seen.complaints.append(dialog.message), dialog.dismiss()))
        page.emulate_media(media="print" if view == "print" else "screen")
        page.goto(path.as_uri())
        return seen

    yield at
    for context in contexts:
        context.close()


def views(names, of_each, *views):
    """(name, view): of the first report all views, and of each other one the view that stands in `of_each`;
    the other views are the study's."""
    return [
        (name, view) if name == "fit" or of_each.get(name) == view else study(name, view)
        for name in names
        for view in views
    ]


@pytest.mark.parametrize(
    ("name", "view"),
    views(
        (*REPORTS, *ZOOMABLE),
        {"circuit": "phone", "controller": "print", "failed": "desk", "open": "dark", "hostile": "phone"}
        | {"sixty": "phone", "lot": "phone", "controller_zoomable": "phone"},
        *VIEWS,
    ),
)
def test_nothing_is_cut_asked_for_or_complained_of(reports, look, name, view):
    seen = look(reports[name], view)
    seen.page.evaluate(OPEN)
    wide, there = seen.page.evaluate(
        "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"
    )
    assert wide <= there and not seen.page.evaluate(BEYOND)
    assert not seen.complaints
    assert [url for url in seen.requests if not url.startswith("data:")] == [reports[name].as_uri()]


def test_no_word_of_a_lot_s_tables_is_broken_on_a_phone(reports, look):
    """Where a table does not fit, it is moved: "succes/sful" and "um/ V" stood there."""
    assert look(reports["lot"], "phone").page.evaluate(BROKEN) == []


def test_its_own_rules_let_it_do_nothing(reports, browser):
    """With the page's policy in force, as a reader has it, no program runs and nothing is refused that it
    needs."""
    page, complaints = browser.new_page(), []
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(reports["controller"].as_uri())
    assert not complaints
    page.evaluate(
        "document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=\"document.title = 1\">')"
    )
    page.wait_for_timeout(100)
    assert page.title() == "Identified plant" and any(
        "Content Security Policy" in text for text in complaints
    )
    page.close()


def test_tables_stack_on_a_phone(reports, look):
    page = look(reports["controller"], "phone").page
    names = "[...document.querySelectorAll('table.stack tr th[scope=row]')]"
    boxes = page.evaluate(f"{names}.map(e => e.getBoundingClientRect().width)")
    assert min(b for b in boxes if b) > 300  # of 390, each name on a line of its own
    assert (
        page.evaluate("getComputedStyle(document.querySelector('.stack td[data-label]'), '::before').content")
        != "none"
    )


def test_sixty_logs_can_be_read_on_a_phone(reports, look):
    """On some ten screens, with texts of figures no smaller than seven pixels."""
    page = look(reports["sixty"], "phone").page
    assert page.evaluate("document.documentElement.scrollHeight") < 12 * 844
    sizes = page.evaluate(
        "[...document.querySelectorAll('svg text')].map(e => e.getBoundingClientRect().height)"
    )
    assert np.quantile(sizes, 0.05) > 7
    assert reports["sixty"].stat().st_size < 1_000_000


def test_a_dark_page_is_dark_and_a_printed_one_is_not(reports, look):
    def lightness(view, of, what):
        seen = look(reports["controller"], view).page.evaluate(
            f"getComputedStyle(document.querySelector('{of}')).{what}"
        )
        return np.mean([float(x) for x in re.findall(r"[\d.]+", seen)[:3]])

    for of, what in (("body", "color"), ("svg text", "fill")):
        assert (
            lightness("dark", of, what) > 200
            and lightness("desk", of, what) < 60
            and lightness("print", of, what) < 60
        )
    assert lightness("dark", "body", "backgroundColor") < 40


def test_in_print_all_logs_are_there_and_no_figure_is_parted(reports, look, browser):
    page = look(reports["sixty"], "print").page
    lines = "[...document.querySelectorAll('table[aria-label=Logs] tbody tr')]"
    rows = page.evaluate(f"{lines}.map(e => e.getBoundingClientRect().height)")
    assert len(rows) == 60 and min(rows) > 5
    assert page.evaluate(
        "[...document.querySelectorAll('figure')].every(e => getComputedStyle(e).breakInside === 'avoid')"
    )


@pytest.mark.parametrize(
    ("name", "view"),
    views(
        ("fit", "circuit", "controller", "failed", "sixty", "lot", *ZOOMABLE[:1]),
        {"circuit": "phone", "controller": "desk", "failed": "dark", "sixty": "phone", "lot": "phone"}
        | {"controller_zoomable": "desk"},
        *("desk", "phone", "dark"),
    ),
)
def test_everyone_can_use_it(reports, look, name, view):
    """The rules of axe-core."""
    axe = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed"
    )
    page = look(reports[name], view).page
    page.evaluate(OPEN)
    found = axe.Axe().run(page).response["violations"]
    assert [(rule["id"], [node["html"][:80] for node in rule["nodes"]]) for rule in found] == []


# --- the figures to zoom into ---

AXIS = "document.getElementById('figure-{}')._fullLayout.{}.range"


@pytest.fixture
def zoomed(reports, browser):
    """The page of a real fit, under its own policy."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(reports["fit_zoomable"].as_uri())
    yield page
    page.close()


def test_a_drag_zooms_in_and_two_clicks_come_back(zoomed):
    before = zoomed.evaluate(AXIS.format(0, "xaxis"))
    zoomed.evaluate("document.getElementById('figure-0').scrollIntoView()")
    box = zoomed.locator("#figure-0 .nsewdrag").first.bounding_box()
    middle = box["y"] + box["height"] / 2

    def at(part):
        return box["x"] + part * box["width"], middle

    zoomed.mouse.move(*at(0.25))
    zoomed.mouse.down()
    zoomed.mouse.move(*at(0.5), steps=5)
    zoomed.mouse.up()
    zoomed.wait_for_timeout(300)
    inside = zoomed.evaluate(AXIS.format(0, "xaxis"))
    wanted = [before[0] + part * (before[1] - before[0]) for part in (0.25, 0.5)]
    assert inside == pytest.approx(wanted, abs=0.01 * (before[1] - before[0]))
    zoomed.mouse.dblclick(*at(0.5))
    zoomed.wait_for_timeout(500)
    assert zoomed.evaluate(AXIS.format(0, "xaxis")) == pytest.approx(before)


def test_every_figure_of_the_report_is_there_to_zoom_into(reports, zoomed, look):
    heads = "[...document.querySelectorAll('h3')].map(e => e.textContent)"
    report = look(reports["fit"], "desk").page
    pictured = report.evaluate("[...document.querySelectorAll('figure h3')].map(e => e.textContent)")
    assert zoomed.evaluate(heads) == pictured
    drawn = zoomed.evaluate(
        "[...document.querySelectorAll('.zoom')].map(e => e.querySelectorAll('.subplot').length)"
    )
    assert len(drawn) == len(pictured) and min(drawn) > 0
    alt = "[...document.querySelectorAll('figure > [role]')].map(e => e.getAttribute('aria-label'))"
    assert zoomed.evaluate(alt) == report.evaluate(alt)
    for page, other in ((report, "fit_zoomable.html"), (zoomed, "fit.html")):
        page.evaluate(OPEN)
        page.locator("main a").first.click()
        assert page.url.endswith(f"/{other}")


def test_figures_to_zoom_into_are_dark_in_the_dark(reports, look):
    def lightness(view):
        page = look(reports["fit_zoomable"], view).page
        shown = page.evaluate("getComputedStyle(document.querySelector('.zoom .xtick text')).fill")
        return np.mean([float(x) for x in re.findall(r"[\d.]+", shown)[:3]])

    assert lightness("dark") > 200 and lightness("desk") < 60 and lightness("print") < 60
