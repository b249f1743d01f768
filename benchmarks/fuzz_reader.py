"""Whatever stands in a file: a log with the numbers that were written, or a LogError.  python benchmarks/fuzz_reader.py

Mutates a corpus of logs and mapping files. An input that runs through a pair of lines of the reader which no earlier one did joins
the corpus. A finding is: an exception of another type, a warning, a mapping file to start from that is no TOML, an answer that
takes SLOW seconds of the processor, a number that is not finite, and numbers that differ from those that Python's own `csv` and
`float` read where the header was left alone. Each finding is made smaller, and stands in fuzz_reader.md beside this file.

Found so, and mended: a header that is blank to Python but not to the reader, or without a name (IndexError); a control character
of a header in a comment of the mapping file to start from, which TOML forbids; a warning where a velocity is divided by 0 Hz; a
unit that pint takes apart and then does not know, nepers times kelvin (UndefinedUnitError); a quote over lines that hold no number
(AttributeError).

It begins with the corpus of earlier runs, fuzz_corpus.txt beside this file (an input a line), and writes there the fewest of the
shortest inputs that run through all of the pairs of lines that it saw.

    --seconds S    how long (default 900)           --seed N       of the mutations (default 0)
    --replay TEXT  run one input, a pair of bytes as the table shows it
"""

import argparse
import ast
import csv
import gzip
import random
import signal
import sys
import tempfile
import time
import tomllib
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sysid.logs.log import Log, LogError
from sysid.logs.read import read_logs

HERE = Path(__file__).parent
CORPUS = HERE / "fuzz_corpus.txt"
MODULES = (
    "textfile", "cells", "stamps", "pieces", "preamble", "sheet", "layout", "csvfile", "csvbody", "mapping", "capture", "missing",
    "labels", "roles", "draft", "header", "benchwords", "log", "units", "waveform", "carrier", "lockin",
)  # fmt: skip
READER = tuple(str(HERE.parent / "sysid" / "logs" / f"{name}.py") for name in MODULES)
SLOW = 10.0  # s of the processor: a table of a few lines takes milliseconds
HEADER = b"time_s,voltage_V,frequency_Hz,wd_um,wq_um"
ROWS = b"0.0,5.0,32300.0,0.0,0.0\n0.1,5.0,32300.0,0.25,-0.5\n0.2,4.0,32300.0,0.5,-0.25\n"
LOG = b"# plate: A7\n# temperature_degC: 24.0\n" + HEADER + b"\n" + ROWS
MAP = b'quantity = "velocity"\nphase_sign = 1\namplitude = "peak"\nrows = [0, 3]\n[columns]\nfrequency = "f_Hz"\nx = "X_V"\n'
MAP += b'y = { column = 2, unit = "mV", scale = 2.0, offset = 0.5 }\n[constants]\nvoltage = "1 V_rms"\n[metadata]\nplate = "A7"\n'
LOCKIN = b"f_Hz,X_V,Y_V,sweep\n100,1,2,a\n200,3,-4,a\n400,5,6,b\n"
CARRIER = b"# kind: waveform\n# sample_rate_kHz: 1\ndrive_V,response_um\n" + b"".join(
    b"%.3f,%.3f\n" % (np.sin(0.7 * k), np.cos(0.7 * k)) for k in range(400)
)
SEEDS = [
    (LOG, b""),
    (LOG.replace(b",", b";").replace(b".", b","), b""),
    (LOG.replace(b",", b"\t").replace(b"\n", b"\r\n"), b""),
    (b"Log,frequency [kHz],w_nm_pp,note\nhot,1,1,\ncold,1,2,\"x, y\"\nhot,2,3,z\n", b""),
    (b"# volts_per_duty: 24\n# lockin_tau_us: 300\ntime,duty,w\nms,%,um\n0,10,1\n1,20,2\n", b""),
    (b"\xef\xbb\xbf# kind: steady\nf_Hz,w_um,temp_K\n1,1,290\n2,2,291\n", b""),
    (CARRIER, b""),
    (b"Model,X\n\nBEGIN A\n" + HEADER + b"\n" + ROWS + b"END\n", b""),
    (b"x-axis,1,2\nsecond,Volt,Volt\n0,1,2\n1,3,4\n2,5,6\n", b'[columns]\ntime = "x-axis_second"\nvoltage = "1_Volt"\nw = "2_Volt"\n'),
    (LOCKIN, MAP),
    (b"a\nb: c\n" + LOCKIN, MAP.replace(b"rows =", b"skip = 2\nrows =")),
    (LOCKIN, MAP.replace(b"rows = [0, 3]", b'split_by = "sweep"\nrows = {a = [0, 1], b = [0, 1]}').replace(b"velocity", b"charge")),
    (b"% a\n10;1,5;-20;30\n11;2,5;-21;40\n", b'comment = "%"\ndelimiter = ";"\ndecimal = ","\nheader = false\nphase_offset_deg = 3\n'
     b'[columns]\ntime = { column = 0, unit = "s" }\nmagnitude = { column = 2, unit = "dB" }\nphase = { column = 3, unit = "deg" }\n'),
    (b"chunk;size;fieldname;;;;\n0;4;frequency;1;2;3;4\n0;4;x;.1;.5;.2;.1\n0;4;y;0;.1;-.2;0\n1;2;frequency;5;6\n1;2;x;1;2\n1;2;y;3;4\n", b""),
    (b"frequency_Hz,1,2,3,4\nwd_um,.1,.5,.2,.1\nwq_um,0,.1,-.2,0\n", b""),
    (b'"4294A"\n"TRACE: A"\nFrequency,|Z|[Ohm]\n1,5\n2,6\n3,7\n\n"TRACE: B"\nFrequency,Theta[deg]\n1,-80\n2,-7\n3,-60\n', b""),
    (b"TRACE: A\nF,V\n1,5\n2,6\n3,7\nTRACE: B\nF,V\n1,-80\n2,-7\n3,-60\n", b'quantity = "impedance"\njoin = "F"\n[columns]\n'
     b'frequency = { column = "F", unit = "Hz" }\nmagnitude = { column = 1, unit = "ohm" }\nphase = { column = 2, unit = "deg" }\n'),
    (b"frequency_Hz,wd_um,wq_um\n" + b"".join(b"%d,%d,%d\n" % (k, k * k, k) for k in range(30)).replace(b"9,81,9", b"9,,9"), b""),
    (b"Frequency (Hz),Z re (Ohm),-Z'' (Ohm)\n1,2,3\n2,3,4\n3,4,5\n", b""),
]  # fmt: skip
WORDS = [
    b",", b";", b"\t", b" ", b"\n", b"\r", b"\r\n", b'"', b"'", b"#", b"# ", b":", b"_", b"[", b"]", b"(", b")", b"{", b"}", b"=",
    b"\x00", b"\xff", b"\xef\xbb\xbf", b"\xc2\xb5", b"\xe2\x80\xa8", b"\x1f\x8b", b"-", b"+", b".", b"0", b"9", b"e", b"1e400",
    b"-0", b"nan", b"inf", b"1_0", b"0x1F", b"32.300", b"32,300", b"1,5", b"%", b"1e-320", b"NA", b"time_s", b"time_ms", b"duty",
    b"w_um", b"wd_um", b"wq_nm", b"frequency_kHz", b"temperature_K", b"force_N", b"voltage_V_rms", b"drive_mA", b"log", b"f_Hz",
    b"t_s", b"kind: steady", b"kind: waveform", b"sampling: settled", b"plate: B", b"sample_rate_Hz: 1000", b"lockin_order: 2",
    b"x", b"y", b"magnitude", b"phase", b"rows", b"split_by", b"scale", b"unit", b"column", b'"dB"', b"true", b"rms", b"pp",
    b"**", b"^", b"m/s", b"degC", b"\\", b"$", b"<", b"\x1b[2J", b"\x85", b"\xa0",
]  # fmt: skip


# --- one input ---------------------------------------------------------------------------------------------------------


@dataclass
class Reader:
    """Runs inputs, and remembers which pairs of lines of the reader were run through one after the other."""

    folder: Path
    seen: set[tuple[str, int, int]] = field(default_factory=set)

    def run(self, table: bytes, toml: bytes) -> tuple[str | None, bool]:
        """What is wrong with the answer (None: nothing), and whether the way to it was new."""
        path, columns = self.folder / "log.csv", self.folder / "map.toml"
        path.write_bytes(table)
        columns.write_bytes(toml)
        pairs: set[tuple[str, int, int]] = set()
        sys.settrace(_tracer(pairs))
        try:
            fault = _fault(lambda: read_logs(path, columns if toml else None), table, toml)
        finally:
            sys.settrace(None)
        new = not pairs <= self.seen
        self.seen |= pairs
        return fault, new


def _tracer(pairs: set[tuple[str, int, int]]) -> Callable:
    def enter(frame, event, _):
        name = frame.f_code.co_filename
        if name not in READER:
            return None
        last = [0]

        def line(frame, event, _):
            if event == "line":
                pairs.add((name, last[0], frame.f_lineno))
                last[0] = frame.f_lineno
            return line

        return line

    return enter


class TookTooLong(BaseException):
    """An answer that does not come; no `except Exception` stops it."""


def _late(*_):
    raise TookTooLong


def _fault(read: Callable[[], list[Log]], table: bytes, toml: bytes) -> str | None:
    before = signal.signal(signal.SIGPROF, _late)
    signal.setitimer(signal.ITIMER_PROF, SLOW)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            logs = read()
    except LogError as error:
        return _fault_of_refusal(error)
    except TookTooLong:
        return f"more than {SLOW:g} s"
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)
        where = next(
            (
                f"{Path(frame.filename).name}:{frame.name}"
                for frame in reversed(at)
                if frame.filename in READER
            ),
            "?",
        )
        return f"{type(error).__name__} in {where}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
    return _fault_of_logs(logs, table) if not toml else None


def _fault_of_refusal(error: LogError) -> str | None:
    try:
        tomllib.loads(error.mapping or "")
    except tomllib.TOMLDecodeError:
        return "a mapping file to start from that is no TOML"
    named = "log.csv" in str(error) or "map.toml" in str(error)
    return None if named else "a refusal that names no file"


def _fault_of_logs(logs: list[Log], table: bytes) -> str | None:
    """Against Python's own reading, where the header is the one of the first seed."""
    head, found, rows = table.partition(HEADER + b"\n")
    above = head.split(b"\n")
    if (
        not found
        or above[-1]
        or any(line.strip() and not line.startswith(b"#") for line in above)
        or len(logs) != 1
    ):
        return None
    try:
        lines = [line.decode("utf-8", errors="replace") for line in rows.split(b"\n") if line.strip(b"\r")]
        cells = [next(csv.reader([line], skipinitialspace=True)) for line in lines]
        if any(cell.strip() for row in cells for cell in row[5:]):
            return "cells beyond the header were read over"
        truth = np.array([[float(cell) for cell in row[:5]] for row in cells])
    except ValueError:
        return "numbers from cells that hold none"
    log = logs[0]
    columns = [log.drive, log.frequency, log.response.real, log.response.imag]
    if log.time is None and b"steady" in head:  # settled points that are stated as such keep no time
        truth = truth[:, 1:]
    else:
        columns = [log.time, *columns]
    found = np.column_stack([np.full(len(log), np.nan) if c is None else c for c in columns])
    return (
        None if found.shape == truth.shape and (found == truth).all() else "other numbers than were written"
    )


# --- mutations ---------------------------------------------------------------------------------------------------------


def mutated(
    pair: tuple[bytes, bytes], corpus: list[tuple[bytes, bytes]], rng: random.Random
) -> tuple[bytes, bytes]:
    """One to four changes of the table or of its mapping file."""
    parts = list(pair)
    which = 1 if parts[1] and rng.random() < 0.6 else 0
    for _ in range(rng.randint(1, 4)):
        parts[which] = _changed(parts[which], rng.choice(corpus)[which], rng)
    if which == 0 and rng.random() < 0.01:
        parts[0] = gzip.compress(parts[0])[: rng.choice([None, None, -5])]
    return parts[0][:20_000], parts[1][:20_000]


def _changed(text: bytes, other: bytes, rng: random.Random) -> bytes:
    at, end = sorted(rng.randint(0, len(text)) for _ in range(2))
    end = min(end, at + rng.choice([1, 1, 4, 20, 200]))
    lines = text.split(b"\n")
    k = rng.randrange(len(lines))
    match rng.randrange(9):
        case 0:
            return text[:at] + rng.choice(WORDS) + text[at:]
        case 1:
            return text[:at] + rng.choice(WORDS) + text[end:]
        case 2:
            return text[:at] + text[end:]
        case 3:
            return text[:at] + text[at:end] * rng.choice([2, 3, 30]) + text[end:]
        case 4:
            return text[:at] + bytes([rng.randrange(256)]) + text[at + 1 :]
        case 5:
            return text.replace(rng.choice(WORDS), rng.choice(WORDS))
        case 6:
            return b"\n".join(lines[:k] + [rng.choice(other.split(b"\n"))] + lines[k:])
        case 7:
            return b"\n".join(lines[:k] + lines[k + 1 :])
        case _:
            cells = lines[k].split(b",")
            cells[rng.randrange(len(cells))] = rng.choice(WORDS)
            return b"\n".join([*lines[:k], b",".join(cells), *lines[k + 1 :]])


def smaller(pair: tuple[bytes, bytes], fault: str, reader: Reader) -> tuple[bytes, bytes]:
    """Leave out what the fault does not need: halves first, single bytes last."""
    for which in (0, 1):
        piece = max(len(pair[which]) // 2, 1)
        while piece:
            at = 0
            while at < len(pair[which]):
                less = pair[which][:at] + pair[which][at + piece :]
                fewer = (less, pair[1]) if which == 0 else (pair[0], less)
                if reader.run(*fewer)[0] == fault:
                    pair = fewer
                else:
                    at += piece
            piece //= 2
    return pair


def kept() -> list[tuple[bytes, bytes]]:
    """The corpus of earlier runs."""
    lines = CORPUS.read_text(encoding="ascii").splitlines() if CORPUS.exists() else []
    return [ast.literal_eval(line) for line in lines]


def fewest(corpus: list[tuple[bytes, bytes]], reader: Reader) -> list[tuple[bytes, bytes]]:
    """The inputs, shortest first, each of which runs through a pair of lines that the shorter ones do not."""
    fresh = Reader(reader.folder)
    return [
        pair
        for pair in sorted(corpus, key=lambda pair: (len(pair[0]) + len(pair[1]), pair))
        if fresh.run(*pair)[1]
    ]


# --- the study ------------------------------------------------------------------------------------------------------------


def table(
    runs: int,
    seconds: float,
    corpus: int,
    reader: Reader,
    found: dict[str, tuple[int, tuple[bytes, bytes]]],
    said: str,
) -> str:
    """The study as Markdown."""
    lines = [
        "# Fuzzing the reader",
        "",
        f"Made by `{said}`.",
        "",
        __doc__.partition("\n\n")[2].partition("\n\n    --")[0],
        "",
    ]
    lines += ["| runs | seconds | pairs of lines | corpus | findings |", "|---|---|---|---|---|"]
    lines += [f"| {runs} | {seconds:.0f} | {len(reader.seen)} | {corpus} | {len(found)} |", ""]
    lines += (
        ["| finding | runs | smallest input (table, mapping) |", "|---|---|---|"]
        if found
        else ["Nothing was found."]
    )
    lines += [
        f"| {fault} | {n} | `{str(pair).replace('|', chr(92) + '|')}` |" for fault, (n, pair) in found.items()
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=900)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--replay")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        reader = Reader(Path(folder))
        if given.replay:
            print(reader.run(*ast.literal_eval(given.replay))[0])
            return
        rng, corpus, found, runs = random.Random(given.seed), SEEDS + kept(), {}, 0
        for pair in corpus:
            assert (fault := reader.run(*pair)[0]) is None, (fault, pair)
        began = time.monotonic()
        while time.monotonic() - began < given.seconds:
            recent = rng.random() < 0.5
            pair = mutated(rng.choice(corpus[-50:] if recent else corpus), corpus, rng)
            fault, new = reader.run(*pair)
            runs += 1
            if fault is not None:
                if fault not in found:
                    found[fault] = (0, smaller(pair, fault, reader))
                    print(f"{fault}: {found[fault][1]}", file=sys.stderr)
                found[fault] = (found[fault][0] + 1, found[fault][1])
            elif new:
                corpus.append(pair)
        seconds = time.monotonic() - began
        kept_now = fewest(corpus, reader)
        CORPUS.write_text("".join(f"{pair}\n" for pair in kept_now), encoding="ascii")
        said = f"python benchmarks/fuzz_reader.py --seconds {given.seconds:g} --seed {given.seed}"
        text = table(runs, seconds, len(corpus), reader, found, said)
    (HERE / "fuzz_reader.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
