"""What a log's metadata say of the bench: the lock-in's filter, a delay, how long points settle, the thermometer's error."""

from collections.abc import Mapping

from sysid import units
from sysid.csvfile import Head, LogError
from sysid.header import metadata_number

BENCH_TIMES = ("lockin_tau", "lockin_boxcar", "delay", "settle")  # in s inside; their metadata may carry another unit of time
NUMBERS = {"lockin_order": "lockin_order", "temperature_std_degc": "temperature_std_degC"}  # in one unit, in any case
BENCH = ("lockin_tau_s", "lockin_boxcar_s", "delay_s", "settle_s", *NUMBERS)


def bench_time(key: str) -> tuple[str, str] | None:
    """`lockin_tau_us` is ("lockin_tau", "us"); None for a key that is not a time of the bench."""
    name = next((name for name in BENCH_TIMES if key.casefold().startswith(f"{name}_")), None)
    return (name, key[len(name) + 1 :]) if name else None


def bench_of(head: Head, metadata: Mapping[str, str]) -> dict[str, float]:
    """What is known of the bench: times in s, the order of the lock-in's filter, and how far its thermometer may be off."""
    bench = {}
    for key, text in metadata.items():
        if name := NUMBERS.get(key.casefold()):
            bench[name] = metadata_number(head, key, text)
        elif named := bench_time(key):
            try:
                units.check_unit("time", named[1])
            except ValueError as error:
                raise LogError(f"{head.path}, metadata {key!r}: {error}") from None
            bench[f"{named[0]}_s"] = float(units.convert(metadata_number(head, key, text), named[1], "s"))
    for key, value in bench.items():
        if key == "lockin_order" and (value < 1 or value % 1):
            raise LogError(f"{head.path}, metadata {key!r}: found {value:g}, expected a whole number of poles")
        if key != "delay_s" and value < 0:
            unit = "degC" if key in NUMBERS.values() else "s"
            raise LogError(f"{head.path}, metadata {key!r}: found {value:g} {unit}, expected 0 or more")
    return bench
