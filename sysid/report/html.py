"""report.html: one file for an engineer to keep; it asks for nothing else and holds no program."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.report.text import advice, cell, clean, derived, gains, grouped, mode, moved, number, promised, row, seconds, taken_for

if TYPE_CHECKING:
    from sysid.posterior.posterior import Posterior


def render(document: Mapping[str, Any], posterior: "Posterior", drawn: Mapping[str, bytes] | None = None) -> str:
    """The report of fit.json's content (`document`) and of the posterior that it sums up. The same inputs, the same text.
    `drawn`: the figures of the logs, where there are any already."""
    from sysid.report.costs import ladder_figure
    from sysid.report.plots import PANELS, log_figures, posterior_figure, step_figure

    figures = {**(log_figures(posterior.fit) if drawn is None else drawn), **posterior_figure(posterior, document["parameters"])}
    figures |= step_figure(document["controller"]) | ladder_figure(document["uncertainty"]["rungs"])
    return template("template.html.j2").render(
        document,
        derived=derived(posterior.draws, document["parameters"]),
        remedy=advice(document["result"], len(document["logs"])),
        gains=gains(document["controller"]) if document["controller"] else [],
        promised=promised(document["controller"]) if document["controller"] else [],
        notes=grouped(document),
        moved=moved(document["change"]) if document["change"] else [],
        added=_added(document["logs"]),
        images={title: b64encode(png).decode() for title, png in figures.items()},
        panels=PANELS,
    )


def template(name: str) -> Any:
    """A page of this folder, of jinja2: nothing that a name or a sentence holds is markup."""
    import jinja2

    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, finalize=_finalize, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"row": row, "cell": cell, "mode": mode, "number": number, "seconds": seconds, "taken_for": taken_for}
    return environment.get_template(name)


def _added(logs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Names of all that the bench added to any log; the noise and the start have no column of their own."""
    names = dict.fromkeys(name for log in logs for name in log["parameters"])
    return [name for name in names if not name.startswith("noise") and not name.startswith("start")]


def _finalize(value: Any) -> Any:
    """Texts without control characters, which HTML forbids even when escaped."""
    return clean(value) if type(value) is str else value
