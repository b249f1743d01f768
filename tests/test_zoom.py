"""Figures that matplotlib has drawn, as plotly is told of them: the same numbers, in the same places."""

import base64
import builtins
import json
import sys

import numpy as np
import pytest
import standin
from test_report import HOSTILE, document

from sysid.report import canvas, html, traces, zoom

pytest.importorskip("plotly", reason="plotly is not installed")
pytest.importorskip("plotly.io")


def told(draw, panels=1):
    """The axes that `draw` fills, as plotly has them; arrays as they are in Python."""
    import plotly.io

    figure = canvas.blank(4, 3)
    draw(*np.ravel(figure.subplots(1, panels)))
    found = plotly.io.from_json(traces.told_of(figure))
    for trace in found.data:
        trace.update(x=numbers(trace.x), y=numbers(trace.y))
    return found


def numbers(array):
    """Numbers (n,) as plotly's program decodes them."""
    return np.frombuffer(base64.b64decode(array["bdata"]), array["dtype"])


def test_lines_and_dots_keep_every_number():
    x, y = np.linspace(0, 1, 50), np.random.default_rng(0).normal(size=50)
    y[7] = np.nan

    def draw(axes):
        axes.plot(x, y, "--", color=canvas.BLUE, label="a line")
        axes.plot(x, -y, color=canvas.ORANGE, drawstyle="steps-post", label="dots", **canvas.DOTS)
        axes.plot(x, y, color=canvas.ORANGE, drawstyle="steps-post")
        axes.legend()

    dots, line, steps = told(draw).data  # dots lie below lines
    np.testing.assert_array_equal(line.x, x)
    np.testing.assert_array_equal(line.y, y)
    np.testing.assert_array_equal(dots.y, -y)
    assert (line.mode, line.line.dash, line.line.color, line.name) == ("lines", "dash", canvas.BLUE, "a line")
    assert (dots.mode, dots.opacity, dots.marker.color) == ("markers", 0.5, canvas.ORANGE)
    assert (steps.line.shape, steps.name, steps.showlegend) == ("hv", "", False)
    assert line.showlegend and dots.showlegend


def test_bands_stairs_and_error_bars_are_there():
    x = np.array([1.0, 2.0, 4.0])

    def draw(axes):
        axes.fill_between(x, x - 1, x + 1, color=canvas.BLUE, alpha=0.3, lw=0)
        axes.errorbar(x, 2 * x, [0.1, 0.2, 0.3], fmt="o", color=canvas.ORANGE)
        axes.stairs([3.0, 5.0], [0.0, 1.0, 2.0], fill=True, color=canvas.GREEN)

    found = told(draw).data
    band = next(t for t in found if t.fillcolor == canvas.BLUE)
    stairs = next(t for t in found if t.fillcolor == canvas.GREEN)
    bars = next(t for t in found if t.mode == "lines" and t.line.color == canvas.ORANGE and t.fill is None)
    corners = {*zip(band.x, band.y, strict=True)}
    assert corners == {(a, a + off) for a in x for off in (-1, 1)}
    assert band.opacity == pytest.approx(0.3) and band.fill == "toself" and band.line.width == 0
    assert {(0, 3), (1, 3), (1, 5), (2, 5)} <= {*zip(stairs.x, stairs.y, strict=True)}
    np.testing.assert_array_equal(bars.x, [1, 1, np.nan, 2, 2, np.nan, 4, 4])
    np.testing.assert_allclose(bars.y, [1.9, 2.1, np.nan, 3.8, 4.2, np.nan, 7.7, 8.3])


def test_spans_and_lines_reach_across_a_panel_wherever_it_is_zoomed_to():
    def draw(_, axes):
        axes.plot([1, 10], [1, 100])
        axes.axhspan(2.0, 3.0, color=canvas.BAND)
        axes.axvline(5.0, color=canvas.GREY, ls=":")
        axes.set(xscale="log", yscale="log", xlim=(1, 10))

    whole = told(draw, 2)
    span, line = whole.layout.shapes
    assert (span.xref, span.yref, span.y0, span.y1, span.x0, span.x1) == ("x2 domain", "y2", 2, 3, 0, 1)
    assert (line.xref, line.yref, line.x0, line.x1, line.line.dash) == ("x2", "y2 domain", 5, 5, "dot")
    axis = whole.layout.xaxis2
    assert axis.type == "log" and axis.range == pytest.approx((0, 1))  # in decades
    left, right = whole.layout.xaxis.domain, axis.domain
    assert left[0] == 0 and right[1] == 1 and left[1] < right[0]


def test_an_axis_whose_labels_are_in_another_unit_is_in_that_unit():
    def draw(axes):
        axes.plot([1.6e-3, 1.7e-3], [0.0, 1.0])
        axes.axvline(1.65e-3)
        axes.set(xlim=(1.6e-3, 1.7e-3), xlabel="tau (ms)")
        axes.set_xticks([1.62e-3, 1.65e-3, 1.68e-3], ["1.62", "1.65", "1.68"])
        axes.set_yticks([0.2, 0.8], ["first", "<b>second"])

    whole = told(draw)
    np.testing.assert_allclose(whole.data[0].x, [1.6, 1.7])
    assert whole.layout.xaxis.range == pytest.approx((1.6, 1.7))
    assert whole.layout.shapes[0].x0 == pytest.approx(1.65)
    assert whole.layout.xaxis.tickmode is None and whole.layout.xaxis.minor.tickvals == pytest.approx(
        (1.62, 1.65, 1.68)
    )
    assert whole.layout.yaxis.ticktext == ("first", "&lt;b&gt;second")  # no markup


def test_what_it_does_not_know_is_no_silent_gap():
    with pytest.raises(TypeError, match="expected lines, bands, spans or stairs"):
        told(lambda axes: axes.scatter([1], [1]))


@pytest.mark.study
def test_a_page_is_the_same_twice_and_holds_no_markup_of_a_name():
    posterior = standin.posterior([standin.fitted(HOSTILE), standin.fitted("b.csv", "steady")])
    content = document(posterior)
    page, again = (zoom.page(content, html.pictured(content, posterior), "a b.html") for _ in range(2))
    assert page == again
    assert "<img src=x" not in page and 'href="a%20b.html"' in page
    data = page.split('id="told">')[1].split("</script>")[0]
    assert "<" not in data and len(json.loads(data)) == page.count('class="zoom"')


def test_without_plotly_it_says_how_to_have_it(monkeypatch):
    real = builtins.__import__

    def none(name, *rest):
        if name.partition(".")[0] == "plotly":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", none)
    for name in [name for name in sys.modules if name.partition(".")[0] == "plotly"]:
        monkeypatch.setitem(sys.modules, name, None)
    posterior = standin.posterior()
    content = document(posterior)
    with pytest.raises(ImportError, match=r"need plotly: pip install 'sysid\[zoom\]'"):
        zoom.page(content, html.pictured(content, posterior), "report.html")
