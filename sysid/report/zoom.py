"""The figures of the report once more, to zoom into: a page beside it, which plotly draws in the browser.

The page holds its program, asks for nothing and runs nothing else."""

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import TYPE_CHECKING, Any

from sysid.report.canvas import VARIABLES
from sysid.report.html import template
from sysid.report.traces import plotly, told_of

if TYPE_CHECKING:
    from sysid.report.canvas import Drawn

HINT = (
    "Drag across a figure to zoom in, click twice to come back; a name in a legend hides what it names, and"
    " shows it again."
)


def page(document: Mapping[str, Any], sections: Mapping[str, "Sequence[Drawn]"], report: str) -> str:
    """The page of the figures in `sections` by their headings, of fit.json's content; `report`: the name of
    the report's file, which stands beside it. The same inputs, the same text. Raises ImportError."""
    plotly()
    from plotly.offline import get_plotlyjs

    library, told = get_plotlyjs(), [told_of(f.figure) for figures in sections.values() for f in figures]
    shown = json.dumps([json.loads(figure) for figure in told], separators=(",", ":"))
    names = json.dumps({colour: f"--{name}" for colour, name in VARIABLES.items()})
    begin = template("zoom.js.j2").render(names=names)
    hashes = [f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'" for text in (library, begin)]
    return template("zoom.html.j2").render(
        plate=document["plate"],
        failed=document["result"] != "successful",
        verdict=document["verdict"],
        sections={title: figures for title, figures in sections.items() if figures},
        report=report,
        hint=HINT,
        policy=" ".join(hashes),
        library=library,
        begin=begin,
        figures=shown.replace("<", "\\u003c"),
    )
