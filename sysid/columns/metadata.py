"""What the metadata of a header state."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

from sysid.columns.plan import Source, is_absent
from sysid.tables import units
from sysid.tables.cells import amount, to_number
from sysid.tables.csvfile import Head, LogError

ALIKE = 1e-6  # by which numbers that are written twice differ where they are the same


def rate_key(metadata: Mapping[str, str]) -> str | None:
    """Under which key the metadata state a sample rate; its end is the unit."""
    return next((key for key in metadata if key.casefold().startswith("sample_rate")), None)


def sample_rate(head: Head, metadata: Mapping[str, str]) -> float | None:
    """The sample rate (Hz) that the metadata state; None where they do not."""
    if (key := rate_key(metadata)) is None:
        return None
    beside = amount(metadata[key]) or ("", "")
    unit = key[len("sample_rate_") :] or beside[1]  # sample_rate: 10 kHz
    try:
        units.check_unit("frequency", unit)
    except ValueError as error:
        raise LogError(f"{head.path}, metadata {key!r}: {error}") from None
    number = metadata_number(head, key, metadata[key], units.Name("frequency", unit, "peak"))
    rate = float(units.convert(number, unit, "Hz"))
    if rate <= 0:
        raise LogError(f"{head.path}, metadata {key!r}: found {rate:.6g} Hz, expected a rate above zero")
    return rate


def stated(metadata: Mapping[str, str], key: str) -> str | None:
    """What the metadata state under `key`, in upper or lower case; None where they are silent or empty."""
    return next((value for name, value in metadata.items() if name.casefold() == key and value), None)


def labelled(key: str, value: str) -> str:
    """The name of a constant with its unit, which may stand behind the number: Temperature: 24 degC."""
    _, unit = amount(value) or ("", "")
    with_unit = f"{key} [{unit}]"
    return with_unit if unit and not units.is_key(key) and units.is_key(with_unit) else key


def refuse_repeated(head: Head, metadata: Mapping[str, str], words: Collection[str]) -> None:
    """Raise LogError when the file states one of `words` twice with different values, and `metadata` has it
    from the file."""
    for key in sorted(head.repeated):
        if key.casefold() in words and metadata.get(key) == head.metadata[key]:
            raise LogError(
                f"{head.path}, metadata {key!r}: found it twice with different values, expected it once"
            )


def metadata_number(head: Head, key: str, text: str, name: units.Name | None = None) -> float:
    """A number of the metadata; see `written_number`."""
    return written_number(head, key, text, name)[0]


def written_number(head: Head, key: str, text: str, name: units.Name | None) -> tuple[float, str]:
    """A number of the metadata, and as it is written; behind it may stand the unit that the key says
    (`name`), or one of its kind, which is converted. Raises LogError where it is none, or where the file
    states two."""
    refuse_repeated(head, {key: head.metadata.get(key, "")}, (key.casefold(),))
    digits, beside = amount(text) or (text, "")
    number = to_number(digits, str(head.dialect.decimal))
    own = units.parse_name(f"{name.quantity} [{beside}]") if name and beside else None
    agrees = own and own.amplitude in ("peak", name.amplitude) and units.fits(name.quantity, own.unit)
    if agrees and units.same_kind(own.unit, name.unit):
        number = float(units.convert(number, own.unit, name.unit))
    elif beside:
        number = math.nan
    if not math.isfinite(number):
        unit = f" of {name.unit}" if name else ""
        alone = "; write the number alone: its unit stands in the key" if amount(text) and name else ""
        if (
            own and name and own.amplitude != name.amplitude and units.fits(name.quantity, own.unit)
        ):  # 100 Vpp
            alone = f"; write {name.quantity}_{own.unit}_{own.amplitude}: {digits}"
        raise LogError(
            f"{head.path}, metadata {key!r}: found {text!r}, expected a finite number{unit}{alone}"
        )
    return number, digits


def stated_constant(head: Head, key: str, text: str, name: units.Name | None) -> Source:
    """The source of an input that the metadata state under `key`, which says what `name` has."""
    number, written = written_number(head, key, text, name)
    return Source(f"metadata {key!r}", "", constant=number, written=written)


def overruled(head: Head, constants: Mapping[str, Source], path: str) -> tuple[str, ...]:
    """A warning on each constant of the mapping file at `path` that a file's metadata state otherwise."""
    found = []
    for key, text in head.metadata.items():
        name = units.parse_name(label := labelled(key, text))
        known = constants.get(name.quantity) if name and units.is_key(label) else None
        if name is None or known is None or not units.same_kind(name.unit, known.unit):
            continue
        try:
            value = float(units.convert(metadata_number(head, key, text, name), name.unit, known.unit))
        except LogError:
            continue  # what is no number states nothing else
        peak = {"rms": 2**0.5, "pp": 0.5}
        ratio = peak.get(name.amplitude, 1.0) / peak.get(known.amplitude, 1.0)
        if not math.isclose(value * ratio, known.constant or 0.0, rel_tol=ALIKE):
            found.append(
                f"metadata {key!r} states {text}, and [constants] of {path} {known.written} {known.unit},"
                " which is taken; leave it out there, and each file's own is read"
            )
    return tuple(found)


def constants_beside(
    head: Head, metadata: Mapping[str, str], sources: Mapping[str, Source], path: str
) -> tuple[dict[str, Source], list[str]]:
    """The constant inputs that the metadata state and the mapping file at `path`, which has `sources`, does
    not, and a note on each; where it is no number, on why it is not used."""
    found: dict[str, Source] = {}
    notes = []
    for key, text in metadata.items():
        label = labelled(key, text)
        name = units.parse_name(label) if units.is_key(label) else None
        if name is None or not name.unit or not is_absent(name.quantity, {**sources, **found}):
            continue
        try:
            source = stated_constant(head, key, text, name)
        except LogError as error:
            notes.append(f"metadata {key!r} is not used: {str(error).rpartition(': ')[2]}")
            continue
        found[name.quantity] = replace(source, unit=name.unit, amplitude=name.amplitude)
        notes.append(f"metadata {key!r} is read as the {name.quantity}: {path} does not say it")
    return found, notes
