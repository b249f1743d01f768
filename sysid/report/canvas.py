"""What every figure has in common: colours that all eyes tell apart, one style, and how a figure becomes an
SVG within a page or an image.

The palette is that of Okabe & Ito (Color Universal Design, 2008). In an SVG the colours of lines and texts
are variables of the page, so that a dark page has its own; dots, which are many, are one image of points."""

import io
import re
import warnings
from base64 import b64decode, b64encode
from collections.abc import Callable, Collection, Sequence
from math import ceil
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from sysid.report.text import PREFIXES

POINTS = 2000  # of one log in one figure
COLOURS = 48  # of dots in two colours, at every depth of their overlap
# inches, of a figure whose texts can be read on a phone, and of which two stand side by side elsewhere
WIDE = 5.2
BLUE, ORANGE, GREEN, PINK, SKY, AMBER, GREY = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#e69f00",
    "#6e6e6e",
)
PALETTE = (BLUE, ORANGE, GREEN, PINK, SKY, AMBER)
GRID, BAND, BLACK = "#e4e4e3", "#e8edf3", "#000000"
VARIABLES = {
    BLUE: "blue",
    ORANGE: "orange",
    GREEN: "green",
    PINK: "pink",
    SKY: "sky",
    AMBER: "amber",
    GREY: "grey",
}
VARIABLES |= {GRID: "grid", BAND: "band", BLACK: "text", "#ffffff": "back"}
DOTS: dict[str, Any] = {"ls": "", "marker": "o", "alpha": 0.5, "mew": 0, "zorder": 1.9, "rasterized": True}
STYLE: dict[str, Any] = {
    "text.parse_math": False,  # names of files are shown as they are
    "text.usetex": False,
    "axes.formatter.use_mathtext": False,
    "svg.fonttype": "none",  # texts stay texts
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.edgecolor": GREY,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": BLACK,
    "ytick.labelcolor": BLACK,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.0,
}


class Picture(NamedTuple):
    """A figure that is wanted: its title, what draws it, what is `seen` on it in words, and how it is to be
    read, a `note`, below which stands what is seen too where that is `told`."""

    title: str
    draw: Callable[[], Figure]
    seen: Callable[[], str]
    note: str = ""
    told: bool = True


class Drawn(NamedTuple):
    """A figure of a page: `svg`, an element; what is `seen` on it; a `caption`; `wide`: it needs the room of
    two; the `figure` itself."""

    title: str
    svg: str
    seen: str
    caption: str
    wide: bool
    figure: Figure


class Figures(dict[str, Figure]):
    """Figures by title, which a notebook shows one below the other."""

    @classmethod
    def of(cls, pictures: Sequence[Picture]) -> "Figures":
        """The wanted figures."""
        return cls({p.title: styled(p.draw) for p in pictures})

    def _repr_html_(self) -> str:
        return "".join(
            f'<p>{title}</p><img alt="{title}" src="data:image/png;base64,{b64encode(png(figure)).decode()}">'
            for title, figure in self.items()
        )


def drawn(pictures: Sequence[Picture]) -> tuple[Drawn, ...]:
    """The wanted figures for a page. The same figures give the same text."""
    with warnings.catch_warnings(), matplotlib.rc_context(STYLE):  # type: ignore[arg-type]
        warnings.filterwarnings(
            "ignore", "Glyph"
        )  # a name in letters that the font lacks; a reader's fonts have them
        found = []
        for p in pictures:
            figure, seen = p.draw(), p.seen()
            caption = f"{seen} {p.note}" if p.told else p.note
            wide = figure.get_figwidth() > 1.1 * WIDE
            found.append(Drawn(p.title, svg(figure, p.title), seen, caption, wide, figure))
        return tuple(found)


def styled(draw: Callable[[], Figure]) -> Figure:
    """A figure in the report's style."""
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type]
        return draw()


def blank(width: float, height: float) -> Figure:
    """An empty figure; sizes in inches."""
    return Figure((width, height), dpi=144)


def png(figure: Figure) -> bytes:
    """An image without the program's name or any time in it."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()


def svg(figure: Figure, key: str) -> str:
    """An SVG element for a page, without a background of its own; `key` tells its parts from those of
    others."""
    figure.patch.set_visible(False)
    for axes in figure.axes:
        axes.patch.set_visible(False)
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": key}):
        none = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        FigureCanvasSVG(figure).print_svg(buffer, metadata=none)
    return _slim(buffer.getvalue())


def _slim(text: str) -> str:
    """The element alone: fonts and colours by the page's own style sheet, hundredths of a point, no
    identifiers but those that are referred to."""
    text = text[text.index("<svg") :]
    width, height = (float(x) for x in re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)[0])
    text = re.sub(
        r"<!--.*?-->|<style.*?</style>|<defs>\s*</defs>", "", text[text.index(">") + 1 :], flags=re.DOTALL
    )
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', text))
    text = re.sub(r"<[a-z][^>]*>", lambda m: _slim_tag(m[0], used), text)
    text = re.sub(r"\s*\n\s*", "\n", text).strip()
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" style="max-width: {width:.0f}pt" aria-hidden="true">{text}'
    )


def _slim_tag(tag: str, used: Collection[str]) -> str:
    """A tag, which may hold an image, but no text of the figure."""
    tag = re.sub(r' id="([^"]*)"', lambda m: m[0] if m[1] in used else "", tag)
    tag = re.sub(r"font-family: [^;\"]*;? ?|stroke-linecap: square;? ?", "", tag)
    tag = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", tag)
    tag = re.sub(r' transform="rotate\(-0 [^"]*"', "", re.sub(r"(\.\d\d)\d+", r"\1", tag))
    tag = re.sub(
        r"base64,([^\"]*)", lambda m: "base64," + b64encode(_few_colours(b64decode(m[1]))).decode(), tag
    )
    return re.sub(
        r"#[0-9a-f]{6}\b", lambda m: f"var(--{VARIABLES[m[0]]})" if m[0] in VARIABLES else m[0], tag
    )


def _few_colours(image: bytes) -> bytes:
    """A PNG of dots with a palette: a quarter of the size."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.open(io.BytesIO(image)).quantize(COLOURS, method=Image.Quantize.FASTOCTREE).save(buffer, "PNG")
    return buffer.getvalue()


def thin(rows: int, most: int = POINTS) -> slice:
    """Every so many rows, that `most` are left."""
    return slice(None, None, ceil(rows / most))


def time_axis(time: np.ndarray) -> tuple[np.ndarray, str]:
    """Time from its first in a unit that gives short numbers, and the label of its axis."""
    time = time - time[0]
    unit, factor = next((p for p in PREFIXES if time[-1] * p[1] >= 2), PREFIXES[-1])
    return factor * time, f"time ({unit})"
