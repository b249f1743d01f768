"""Which logs belong to which plate: by the plate that they name, by their folder, or by a pattern of their
names."""

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sysid import asked
from sysid.columns.mapping import MappingFile
from sysid.columns.metadata import stated
from sysid.fleet import many
from sysid.logs.alike import Alike
from sysid.logs.log import Log
from sysid.logs.opening import expanded, opened
from sysid.tables.prose import is_prose
from sysid.tables.textfile import LogError

PLATE, FOLDER = "plate", "folder"  # ways of `by`; any other is a pattern
# Endings of logs, which a folder holds beside other files; behind them may stand that of a packed one.
TEXT, BINARY = (
    "csv|tsv|txt|dat|asc|jsonl|ndjson|uff|unv|s\\d+p|ts",
    "h5|hdf5|mat|parquet|feather|arrow|wav|tdms",
)
NOTES = r"\.(txt|dat|asc)(\.(gz|bz2|xz))?$"  # of logs, and of notes on them as well
ENDINGS = rf"\.({TEXT}|{BINARY})(\.(gz|bz2|xz))?$"
Given = str | Path | Log
alike = Alike()  # the heads of files that this process has met


@dataclass(frozen=True)
class Group:
    """The logs of one plate, files or Logs; or the sentence by which its one file was `refused`; or why it is
    `alone`, to be fitted by itself."""

    plate: str
    logs: tuple[Given, ...] = field(repr=False)
    refused: str = ""
    alone: str | None = None


def grouped(
    groups: Any,
    by: str,
    mapping: MappingFile | None = None,
    beside: Path | None = None,
    aside: list[str] | None = None,
) -> list[Group]:
    """The plates of `groups`: a mapping from a plate's name to its logs; a sequence of such logs, each of one
    plate; or one sequence of files, folders and Logs, parted `by` what they state.

    `beside`: a folder of results, whose files are no logs; `aside` gets the files of folders that hold no
    table, or that a pattern leaves out. Raises LogError where there is nothing to fit, or two plates have one
    name, ValueError for a `by` that is none.
    """
    if isinstance(groups, Mapping):
        return _distinct([Group(str(name), _several(logs)) for name, logs in groups.items()])
    given = _several(groups)
    if not given:
        raise LogError("found no logs, expected at least one file")
    if all(isinstance(item, Given) for item in given):
        return parted(given, by, mapping, beside, [] if aside is None else aside)
    if any(isinstance(item, Given) for item in given):
        raise LogError("found logs beside groups of logs, expected either")
    return _distinct([_named(_several(logs), k) for k, logs in enumerate(given)])


def _several(logs: Any) -> tuple:
    if isinstance(logs, Given):
        return (logs,)
    asked.given("logs", logs, Iterable, "files, folders or Logs, or a mapping from plates to these")
    return tuple(logs)


def _named(logs: tuple[Given, ...], number: int) -> Group:
    """A group by the plate that its first log states, else by its place, counted from 1."""
    named = stated(logs[0].metadata, "plate") if logs and isinstance(logs[0], Log) else None
    return Group(named or str(number + 1), logs)


def _distinct(groups: list[Group]) -> list[Group]:
    name, times = Counter(group.plate for group in groups).most_common(1)[0] if groups else ("", 0)
    if times > 1:
        raise LogError(f"found {times} groups of the plate {name!r}, expected one with all of its logs")
    return groups


def parted(
    given: Sequence[Given], by: str, mapping: MappingFile | None, beside: Path | None, aside: list[str]
) -> list[Group]:
    """Files, folders and Logs as plates, in the order of their first log; `aside` gets what is no log."""
    sure = pattern(by) if by not in (PLATE, FOLDER) else None
    found: dict[str, list[Given]] = {}
    refused: list[Group] = []
    nameless: list[Given] = []
    strange: list[Given] = []
    for item, root in _files(given, beside, aside):
        try:
            for name, logs, why in _plates(item, root if len(given) == 1 else None, by, sure, mapping):
                if why:
                    refused.append(Group(name or _called(item), (item,), why))
                elif name is None:
                    (strange if sure else nameless).append(item)
                else:
                    found.setdefault(name, []).extend(logs)
        except LogError as error:  # a row of its own: a file that cannot be read states no plate
            refused.append(Group(str(item), (item,), str(error)))
    _check(found, nameless, strange, by)
    strange = _of_their_kind(strange, found, given, aside)
    refused = [replace(g, plate=f"{g.plate} in {g.logs[0]}") if g.plate in found else g for g in refused]
    refused += [Group(_called(item), (item,), _nameless(item)) for item in nameless]
    refused += [
        Group(_called(item), (item,), f"{_called(item)}: its name does not fit {by!r}") for item in strange
    ]
    return [*(Group(name, tuple(logs)) for name, logs in found.items()), *refused]


def pattern(text: str) -> re.Pattern[str]:
    """A regular expression with one group, the plate. Raises ValueError for another."""
    expected = f"expected {PLATE}, {FOLDER}, or a regular expression with one group, as in '(.*)_step'"
    try:
        found = re.compile(text)
    except re.error as error:
        raise ValueError(f"found {text!r}, {expected}: {error}") from None
    if found.groups != 1:
        raise ValueError(f"found {text!r} with {found.groups} groups, {expected}")
    return found


def _files(
    given: Iterable[Given], beside: Path | None, aside: list[str]
) -> Iterable[tuple[Given, Path | None]]:
    """Each log once, with the folder that it was found in, if one was given; a folder's in the order of their
    names. `aside` gets those of a folder that are prose."""
    known: set[str] = set()
    for item in given:
        if isinstance(item, Log):
            yield item, None
            continue
        for path in expanded([item]):
            if not os.path.lexists(path):
                raise LogError(f"{path}: found no such file or folder, expected logs, or a folder of logs")
            root = Path(path) if os.path.isdir(path) else None
            files = [path] if root is None else within(root, beside)
            notes = {
                file for file in files if root and re.search(NOTES, file, re.IGNORECASE) and is_prose(file)
            }
            aside += sorted(notes)
            files = [file for file in files if file not in notes]
            if not files:
                raise LogError(f"{path}: found no logs in this folder, expected files such as *.csv")
            for file in files:
                if file not in known:
                    known.add(file)
                    yield file, root


def within(root: Path, beside: Path | None) -> list[str]:
    """The logs below a folder; nothing hidden, and nothing of the results `beside` them."""
    files: list[str] = []
    for folder, below, names in os.walk(root):
        below[:] = sorted(name for name in below if not name.startswith("."))
        if beside is not None:
            below[:] = [name for name in below if (Path(folder) / name).resolve() != beside.resolve()]
            if Path(folder).resolve() == beside.resolve():
                names = [name for name in names if Path(name).stem != "fleet"]
        logs = (
            name for name in names if re.search(ENDINGS, name, re.IGNORECASE) and not name.startswith(".")
        )
        files += (os.path.join(folder, name) for name in sorted(logs))
    return files


def _plates(
    item: Given, root: Path | None, by: str, sure: re.Pattern[str] | None, mapping: MappingFile | None
) -> Iterator[tuple[str | None, Sequence[Given], str]]:
    """The plates of one log, or of one table of many, as `many.plates` has them. Raises LogError for a file
    that cannot be read."""
    table = None if by != PLATE or mapping is not None or isinstance(item, Log) else many.plates(item)
    if table is None:
        yield _plate(item, root, by, sure, mapping), (item,), ""
    else:
        yield from table


def _plate(
    item: Given, root: Path | None, by: str, sure: re.Pattern[str] | None, mapping: MappingFile | None
) -> str | None:
    """The name of the plate of one log; None where nothing says it. `root`: what folders' names are relative
    to. Raises LogError for a file that cannot be read."""
    path = Path(item.path if isinstance(item, Log) else item)
    if by == FOLDER:
        inside = path.parent if root is None else path.parent.relative_to(root)
        return None if not path.name else root.name if root and inside == Path() else inside.as_posix()
    if sure is not None:
        found = sure.search(item.name if isinstance(item, Log) else path.name)
        return found[1] if found else None
    if isinstance(item, Log):
        return stated(item.metadata, "plate")
    if mapping is None:
        name, sure_of_it = alike.plate(str(path))
        if sure_of_it:
            return name
    if mapping is not None:  # of a capture in several files, each states its plate
        mapping = replace(mapping, options={k: v for k, v in mapping.options.items() if k != "columns"})
    with opened({"": str(path)}, mapping) as head:
        pass
    return stated(mapping.metadata(head) if mapping else head.metadata, "plate")


def _called(item: Given) -> str:
    return item.name if isinstance(item, Log) else str(item)


def _nameless(item: Given) -> str:
    return f"{_called(item)}: found no plate, expected its name above the header, as in `# plate: A7`"


def _of_their_kind(
    strange: Sequence[Given], found: Mapping[str, Sequence[Given]], given: Sequence[Given], aside: list[str]
) -> list[Given]:
    """Those whose names do not fit that may be logs all the same: they were named, or end as a log does whose
    name fits. `aside` gets the others, which a folder holds beside its logs."""
    ours = {_ending(log) for logs in found.values() for log in logs}
    named = {item if isinstance(item, Log) else str(item) for item in given}
    held = [item for item in strange if (item if isinstance(item, Log) else str(item)) not in named]
    others = [item for item in held if _ending(item) not in ours]
    aside += map(_called, others)
    return [item for item in strange if item not in others]


def _ending(item: Given) -> str:
    """Of a file's name, as of its kind; "" of a log without one."""
    found = re.search(ENDINGS, item.path if isinstance(item, Log) else str(item), re.IGNORECASE)
    return found[0].casefold() if found else ""


def _check(found: Mapping[str, Any], nameless: Sequence[Given], strange: Sequence[Given], by: str) -> None:
    """Raise LogError where no log at all says its plate."""
    if nameless and not found:
        raise LogError(
            f"{_nameless(nameless[0])}; or else state --by folder, or a pattern of the files' names"
        )
    if strange and not found:
        said = f"found a name that does not fit {by!r}, and no other that does; expected one"
        raise LogError(f"{_called(strange[0])}: {said}")
