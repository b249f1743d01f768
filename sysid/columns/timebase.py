"""The time of rows, where no column bears its name: samples that are counted at a stated rate, a column that
goes up in a unit of time, one that may be a time; and what is said of them."""

from collections.abc import Collection, Mapping
from itertools import pairwise

from sysid.columns.labels import counts_days
from sysid.columns.metadata import sample_rate, stated
from sysid.columns.plan import Source
from sysid.columns.synonyms import LETTERS, SYNONYMS, add_source, is_called_time
from sysid.tables import units
from sysid.tables.cells import to_number
from sysid.tables.csvfile import Head
from sysid.tables.stamps import EXAMPLE, is_local

PASSING = 9  # steps that all go up: of a column in no order one in 10! does
# what counts the rows of an even sampling; "": the index that pandas writes, which has no name
SAMPLES = (
    *("sample", "samples", "sample_no", "sample_number", "sample_index"),
    *("index", "idx", "row", "no", "n", "#", ""),
)


def numbered(rate: float) -> Source:
    """The time of rows that follow one another at a rate (Hz)."""
    return Source("the rows' number", "s", scale=1 / rate, counted=True)


def counter_of(head: Head, labels: Collection[str]) -> str | None:
    """The column that counts the samples, by its name and its first rows; None where there is none."""
    counting = (
        label
        for label in labels
        if label.strip().casefold() in SAMPLES
        and (first := _first_numbers(head, label))
        and all(after == before + 1 for before, after in pairwise(first))
    )
    return next(counting, None)


def rate_of(head: Head, sources: Mapping[str, Source], counter: str | None) -> float | None:
    """The sample rate (Hz) of rows without a time: the one that is stated, of counted rows and of those of a
    transient; else None. Raises LogError where it is no rate."""
    if counter is None and stated(head.metadata, "kind") != "transient" and not seems_timed(head, sources):
        return None
    return sample_rate(head, head.metadata)


def evenly(head: Head, rate: float) -> str:
    """What is said of rows whose time is counted from a stated rate alone."""
    return (
        f"{head.name}: found no time; its rows are taken as one every {1 / rate:.7g} s, by the sample rate"
        f" that is stated; where rows were left out or averaged since, state that rate, or `# kind: steady`"
        f" of settled points"
    )


def add_time(head: Head, unknown: list[str], sources: dict[str, Source]) -> list[str]:
    """Enter the column that is a time by its unit, whatever it is called, where there is no other: one that
    goes up from row to row, and of rows at several frequencies one with a word for time in its name. It
    leaves `unknown`; a note on it."""
    transient = seems_timed(head, sources) or stated(head.metadata, "kind") == "transient"
    for label in unknown if "time" not in sources else ():
        name, unit, _ = units.split_unit(label)
        unit = "d" if counts_days(label, _first_numbers(head, label)) else unit
        steps = [after - before for before, after in pairwise(_first_numbers(head, label))]
        called = transient or any(map(is_called_time, name.split()))
        if called and units.fits("time", units.short(unit)) and steps and min(steps) > 0:
            add_source(head, sources, f"time [{unit}]", Source(label, "", column=head.names.index(label)))
            unknown.remove(label)
            return [f"column {label} is read as time, by its unit and as it goes up"]
    return []


def passing_of(head: Head, labels: Collection[str]) -> str | None:
    """The column that may be a time: one that goes up in the first rows, and is called so, without a unit, or
    has no name, or goes up in each of them and has no unit; or one of dates. None where there is none."""
    for label in sorted(labels, key=is_called_time, reverse=True):
        steps = [after - before for before, after in pairwise(_first_numbers(head, label))]
        called = is_called_time(label) or not label.strip()
        bare = len(steps) >= PASSING and not units.is_known(units.split_unit(label)[1])
        up = bool(steps) and sum(steps) > 0 and min(steps) >= 0
        column = head.names.index(label)
        dates = {tuple(row[column : column + 1]) for row in head.sample if head.dated(column)}
        if (up and (called or (bare and min(steps) > 0))) or len(dates) > 1:
            return label
    return None


def _first_numbers(head: Head, label: str) -> list[float]:
    column, mark = head.names.index(label), str(head.dialect.decimal)
    return [to_number(row[column], mark) for row in head.sample if column < len(row)]


def seems_timed(head: Head, sources: Mapping[str, Source]) -> bool:
    """Whether rows without a time look like those of a transient: at one frequency, and not said to be
    settled."""
    frequency = sources.get("frequency")
    if stated(head.metadata, "kind"):
        return False
    column = None if frequency is None else frequency.column
    return column is None or len({row[column] for row in head.sample if column < len(row)}) == 1


def untimed(head: Head, counter: str | None, passing: str | None) -> tuple[str, ...]:
    """What to say of rows that are counted, or whose time has no unit, and that are read without a time; the
    ways to say it. Empty of any other rows."""
    if (label := passing if counter is None else counter) is None:
        return ()
    called = f"a column {label!r}" if label.strip() else "a column without a name"
    if counter is not None:
        found, way = (
            f"{called} that counts the rows",
            "state `# sample_rate_Hz: 10000`, say, above the header",
        )
    else:
        bare = is_called_time(label) and not units.fits("time", units.short(units.split_unit(label)[1]))
        states = "states no unit of time" if bare or not label.strip() else "may be one"
        found, unit = (
            f"{called} that goes up and {states}",
            "whatever its unit is, give the unit in a mapping file",
        )
        way = f"call it {_with_unit_of_time(label)}, or {unit} (--columns)"
    way += ", or `# kind: steady` of settled points"
    return (f"{head.name}: found no time, and {found}, taken as settled points; {way}",)


def why_no_time(head: Head, label: str) -> str:
    """Why a column that is called a time, in a file that has no other, is not read as one."""
    if not is_called_time(label):
        return ""
    if is_local(head.first(head.names.index(label))):
        return f": a date of a form that is not read; write a time as {EXAMPLE}"
    if units.fits("time", units.short(units.split_unit(label)[1])):
        return ": it does not go up from row to row, as a time does"
    return f": it states no unit of time; call it {_with_unit_of_time(label)}"


def _with_unit_of_time(label: str) -> str:
    """What to call a column of times, by a name that is read as one."""
    name = units.split_unit(label)[0]
    name = name if (SYNONYMS | LETTERS).get(name.casefold()) == "time" else "time"
    return f"{name}_s, {name}_ms"


def called(label: str) -> str:
    """What a column is called in a sentence."""
    return f"column {label}" if label.strip() else "a column without a name"
