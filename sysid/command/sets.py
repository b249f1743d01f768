"""The whole set of files of a result, as the command and `save` write it; and how it is loaded again."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.command import outputs
from sysid.command.kept import KeptError, pack, unpack
from sysid.posterior.change import Change
from sysid.posterior.posterior import Posterior
from sysid.verdict.fitted import Fit
from sysid.verdict.result import Result
from sysid.whole import in_place_of

if TYPE_CHECKING:
    from sysid.posterior.foreseen import Advised
    from sysid.report.canvas import Drawn


def save(
    posterior: Posterior,
    folder: str | Path,
    loop: Any = None,
    warnings: Sequence[str] | None = None,
    zoomable: bool = False,
) -> Path:
    """Put the set into `folder` in the place of an older one; see `Posterior.save`. `warnings`: instead of
    the fit's."""
    folder = Path(folder)
    content = described(posterior, loop, posterior.fit.warnings if warnings is None else warnings)
    with outputs.staging(folder) as fresh:
        put(fresh, content, posterior, loop, zoomable=zoomable)
        finish(fresh, content)
        outputs.place(fresh, folder)
    return folder


def save_whole(posterior: Posterior, folder: Path) -> Path:
    """As `save`, with the controller that `identify` designs, where there is one."""
    from controller import design

    loop, warnings = None, list(posterior.fit.warnings)
    if posterior.result is Result.successful:
        try:
            loop = design(posterior)
        except ValueError as error:  # no drive was recorded
            warnings.append(str(error))
    return save(posterior, folder, loop, warnings)


def report(posterior: Posterior, path: str | Path, loop: Any = None, zoomable: bool = False) -> Path:
    """Write report.html alone, to `path`; see `Posterior.report`."""
    path, content = Path(path), described(posterior, loop, posterior.fit.warnings)
    _put_report(path, content, posterior, None, zoomable)
    return path


def _put_report(
    path: Path,
    content: Mapping[str, Any],
    posterior: Posterior,
    figures: "Sequence[Drawn] | None",
    zoomable: bool,
) -> None:
    """The report, and beside it where that is wanted the page of its figures to zoom into."""
    from sysid.report import html

    whole = html.pictured(content, posterior, figures)
    beside = path.with_stem(f"{path.stem}_zoomable") if zoomable else None
    pages = {path: html.render(content, posterior, whole, None if beside is None else beside.name)}
    if beside is not None:
        from sysid.report import zoom

        pages[beside] = zoom.page(content, whole, path.name)
    with in_place_of(*pages) as fresh:
        for file, text in zip(fresh, pages.values(), strict=True):
            file.write_text(text, encoding="utf-8", newline="\n")


def load(folder: str | Path) -> Fit:
    """The fit of a set that `identify`, `fit.save` or `posterior.save` wrote, by its folder or its fit.json,
    and as `fit.posterior` the posterior with it.

    Nothing of it is run: the file holds numbers, texts and names of a few types. Raises ValueError, with
    the file, what was found and what was expected, for a folder without a set, for files that are cut off,
    changed or of another run, and for a set of another version whose parts have changed since.
    """
    folder = Path(folder)
    folder = folder.parent if folder.name == outputs.FIT else folder
    wanted = _digest(folder / outputs.FIT)
    path = folder / outputs.KEPT
    try:
        whole = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error}") from None
    if hashlib.sha256(whole).hexdigest() != wanted:
        raise ValueError(
            f"{path}: found other bytes than {outputs.FIT} says: cut off, changed or of another run"
        )
    try:
        posterior = unpack(whole)
    except KeptError as error:
        raise ValueError(f"{path}: {error}") from None
    if not (isinstance(posterior, Posterior) and isinstance(posterior.fit, Fit)):
        raise ValueError(f"{path}: found something else, expected a posterior of a fit")
    fit = posterior.fit
    vars(fit)["posterior"] = posterior  # in the place of one that would be drawn
    return fit


def described(
    posterior: Posterior,
    loop: Any,
    warnings: Sequence[str],
    advice: "Advised | None" = None,
    change: Change | None = None,
) -> dict[str, Any]:
    """The content of fit.json but for `files` and `cost`."""
    from controller import as_dict
    from sysid.verdict.bench import nuisances
    from sysid.verdict.comparison import compare

    fit = posterior.fit
    compared = compare(fit) if fit.result.bounded else ()
    return outputs.document(
        posterior, loop and as_dict(loop), warnings, compared, nuisances(fit), advice, change
    )


def put(
    fresh: Path,
    content: Mapping[str, Any],
    posterior: Posterior,
    loop: Any,
    figures: "Sequence[Drawn] | None" = None,
    zoomable: bool = False,
) -> None:
    """Write all files but fit.json into `fresh`. `figures`: those of the fit, where there are
    any already; `zoomable`: with the page of figures to zoom into."""
    from controller import export_c

    outputs.write_draws(posterior, fresh / outputs.DRAWS)
    (fresh / outputs.KEPT).write_bytes(pack(posterior))
    _put_report(fresh / outputs.REPORT, content, posterior, figures, zoomable)
    if loop is not None:
        text = outputs.to_json(content["controller"])
        (fresh / outputs.CONTROLLER).write_text(text, encoding="ascii", newline="\n")
        export_c(loop, fresh / outputs.HEADER)


def finish(fresh: Path, content: dict[str, Any], cost: Mapping[str, Any] | None = None) -> str:
    """Enter the files of `fresh` and the `cost` into the content, and write it as fit.json; returns its
    text."""
    content |= {"files": outputs.digests(fresh), "cost": dict(cost or {})}
    text = outputs.to_json(content)
    (fresh / outputs.FIT).write_text(text, encoding="ascii", newline="\n")
    return text


def _digest(path: Path) -> str:
    """sha256 of the kept result, as fit.json has it."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(
            f"{path}: cannot be read: {error}; expected a folder that identify or fit.save wrote"
        ) from None
    except (ValueError, RecursionError):
        raise ValueError(
            f"{path}: found no JSON, expected what identify or fit.save wrote: it is cut off or changed"
        ) from None
    if not isinstance(content, dict) or content.get("schema") != outputs.SCHEMA:
        raise ValueError(
            f"{path}: found no fit of schema {outputs.SCHEMA}, expected what identify or fit.save wrote"
        )
    files = content.get("files")
    if not isinstance(files, dict) or not isinstance(found := files.get(outputs.KEPT), str):
        raise ValueError(
            f"{path}: found no {outputs.KEPT} among its files, expected one; run identify again on the logs"
        )
    return found
