"""Traces below one another, tables that lie across, a channel a file: read as what was measured, or refused
by line.

The truth is the circuit R, L, C beside C0, and a carrier of known level, in closed form.
"""

import tomllib

import numpy as np
import pytest
from refusal import draft_of, refused
from test_drafts import answered, asked

import sysid
from sysid.logs.log import LogError
from sysid.logs.read import read_logs

R1, L1, C0, F0 = 2000.0, 1.669041, 2e-9, 32300.0
TAU = 2 * L1 / R1  # s
F = np.arange(31800.0, 32801.0, 5.0)


def impedance(seed=None):
    """Ohm; with noise of 0.2 % of it."""
    omega = 2 * np.pi * F
    C1 = 1 / (L1 * (2 * np.pi * F0) ** 2)
    Z = 1 / (1j * omega * C0 + 1 / (R1 + 1j * omega * L1 + 1 / (1j * omega * C1)))
    rng = np.random.default_rng(seed)
    return Z * (
        1
        + (
            0.002 * (rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F)))
            if seed is not None
            else 0
        )
    )


Z = impedance()
PARTS = {"|Z|": np.abs, "THETA": lambda z: np.degrees(np.angle(z)), "R": np.real, "X": np.imag}
ABOVE = '"4294A REV1.11"\r\n"DATE: Oct 10 2023"\r\n"SWEEP TYPE: LIN FREQ"\r\n"NUMBER OF POINTS: 201"\r\n\r\n'


def trace(title, head, column, *others):
    rows = "".join(
        "\t".join(f"{x:.11e}" for x in row) + "\r\n" for row in zip(F, column, *others, strict=True)
    )
    return f"{title}{head}\r\n{rows}"


def raw_4294a(z, parts=("|Z|", "THETA"), said=True):
    """As the instrument saves its traces: real and imaginary part of each, the latter zero."""
    head = '"Frequency"\t"Data Trace Real"\t"Data Trace Imag"'
    text = ABOVE
    for letter, part in zip("AB", parts, strict=True):
        title = f'"TRACE: {letter}"\r\n' + (f'"FORMAT: {part}"\r\n\r\n' if said else "\r\n")
        text += trace(title, head, PARTS[part](z), 0 * F) + "\r\n"
    return text


def named_4294a(z):
    """With heads that say what they are."""
    pair = (("A", "|Z|[Ohm]", "|Z|"), ("B", "Theta[deg]", "THETA"))
    return ABOVE + "".join(
        trace(f'"TRACE: {k}"\r\n', f"Frequency\t{head}", PARTS[part](z)) for k, head, part in pair
    )


def blocks_e4990a(z):
    """A block a channel, as a Keysight writes them."""
    text = "!Agilent Technologies,E4990A,MY52,A.02.10\n!Date: Fri Apr 03 13:41:16 2015\n"
    for k, head, part in ((1, "|Z|(Ohm)-data", "|Z|"), (2, "theta-z(deg)-data", "THETA")):
        text += f"BEGIN CH{k}_DATA\nFrequency(Hz), {head}\n"
        text += "".join(f"{f:+.11e}, {x:+.11e}\n" for f, x in zip(F, PARTS[part](z), strict=True)) + "END\n"
    return text


def one_table(z):
    head = (
        "!Agilent Technologies,E4990A,MY52,A.02.10\nBEGIN CH1_DATA\nFrequency(Hz), |Z|(Ohm)-data,"
        " theta-z(deg)-data\n"
    )
    return head + "".join(
        f"{f:+.11e}, {a:+.11e}, {b:+.11e}\n" for f, a, b in zip(F, np.abs(z), PARTS["THETA"](z), strict=True)
    )


FILES = {
    "4294A": raw_4294a,
    "4294A without formats": lambda z: raw_4294a(z, said=False),
    "4294A, R and X": lambda z: raw_4294a(z, ("R", "X")),
    "4294A, named": named_4294a,
    "E4990A, blocks": blocks_e4990a,
    "E4990A": one_table,
}


@pytest.mark.parametrize("form", FILES)
def test_an_analyser_s_draft_reads_it_as_it_is_printed(save, form):
    path = save(FILES[form](Z))
    for (log,) in (read_logs(path), read_logs(path, columns=save(draft_of(path), "map.toml"))):
        np.testing.assert_allclose(
            log.response, 1 / Z / (2 * np.pi * F), rtol=1e-9
        )  # of 12 digits, and an angle of them
        assert (len(log), log.kind, log.drive_unit) == (201, "steady", "V")


def test_f0_and_tau_of_an_analyser_s_raw_file(save):
    z = []
    for seed in range(8):
        path = save(raw_4294a(impedance(seed)))
        fit = sysid.fit(read_logs(path))
        assert fit.result.name == "successful", fit.warnings
        z += [
            (fit.parameters[k].value - true) / fit.parameters[k].std for k, true in (("f0", F0), ("tau", TAU))
        ]
    assert np.max(np.abs(z)) < 3.8  # of 16 numbers that are nearly normal: by chance in one of 400
    assert np.sqrt(np.mean(np.square(z))) < 1.6


JOINED = 'quantity = "impedance"\njoin = "Frequency"\n[columns]\nfrequency = { column = "Frequency", unit = "Hz" }\n'
JOINED += 'magnitude = "|Z|[Ohm]"\nphase = "Theta[deg]"\n'


NAMED = (
    named_4294a(Z).replace("\r\n\r\n", "\r\n").split("\r\n")
)  # rows of A in lines 7 to 207, of B in 210 to 410


@pytest.mark.parametrize(
    ("line", "old", "new", "words"),
    [
        (
            217,
            "3.18350",
            "3.18355",
            ["line 217", "column 'Frequency'", "3.18355", "as in line 14", "one measurement"],
        ),
        (217, "3.18350", "OL", ["line 217", "column 'Frequency'", "found OL"]),
        (410, None, None, ["line 210", "200 rows", "expected 201", "line 7"]),
        (300, None, None, ["line 210", "200 rows", "expected 201", "line 7"]),
        (
            209,
            "Theta",
            "spare\tTheta",
            ["line 209", "'Frequency\\tspare\\tTheta[deg]'", "the header of another table"],
        ),
        (209, "Frequency", "Freq", ["line 210", "Freq, Theta[deg]", "'Frequency' once"]),
        (208, "TRACE: B", "oops", []),
        (209, None, None, ["line 208", "TRACE: B", "the header of another table"]),
        (16, "\t", "\tOL", ["line 16", "|Z|[Ohm]", "a finite number"]),
        (16, "3.18450", "x\t3", ["line 16", "'x", "the header of another table"]),
    ],
)
def test_traces_that_do_not_fit_are_refused_by_line(save, line, old, new, words):
    lines = list(NAMED)
    assert old is None or old in lines[line - 1]
    lines[line - 1 : line] = [] if old is None else [lines[line - 1].replace(old, new, 1)]
    path, columns = save("\r\n".join(lines)), save(JOINED, "map.toml")
    if words:
        refused(path, *words, columns=columns)
    else:
        assert len(read_logs(path, columns=columns)[0]) == 201


def test_traces_that_are_no_impedance_are_not_taken_for_one(save):
    """Of a capacitance and a loss nobody is told that they are real and imaginary part."""
    PARTS["Cp"], PARTS["D"] = lambda z: (1 / z).imag / (2 * np.pi * F), lambda z: (1 / z).real / (1 / z).imag
    draft = refused(save(raw_4294a(Z, ("Cp", "D")))).mapping
    assert 'quantity = "?"' in draft and not {"x", "y", "phase"} & {*tomllib.loads(draft)["columns"]}


def test_one_table_cannot_be_joined(save):
    path = save(one_table(Z))
    refused(
        path,
        "1 table",
        "'Frequency(Hz)'",
        columns=save(JOINED.replace('"Frequency"', '"Frequency(Hz)"'), "map.toml"),
    )


def test_traces_of_different_stimuli_are_drafted_each_for_itself(save):
    """A second sweep over other frequencies is another measurement, and no second part."""
    other = named_4294a(Z).replace("3.18", "3.19")
    text = named_4294a(Z)
    text = text[: text.index('"TRACE: B"')] + other[other.index('"TRACE: B"') :]
    path = save(text)
    assert "join" not in draft_of(path)
    refused(path, "another table begins", "join them")


def test_a_header_again_with_the_contract_s_names_is_still_a_log_of_its_own(save):
    text = "frequency_Hz,w_um\n" + "".join(f"{f},{k}\n" for k, f in enumerate(F))
    assert len(read_logs(save(text + text))) == 2


# Tables that lie across


def labone(*chunks, fields=("x", "y")):
    """As LabOne saves a sweep: a line a field, `chunk;timestamp;size;fieldname` before its numbers."""
    n = max(len(s) for _, s in chunks)
    lines = ["chunk;timestamp;size;fieldname" + ";" * n]
    for k, (f, s) in enumerate(chunks):
        values = {"frequency": f, "grid": f, "x": s.real, "y": s.imag, "r": np.abs(s), "phase": np.angle(s)}
        values |= {"bandwidth": 10 + 0 * f, "xstddev": 1e-6 + 0 * f}
        for name in ("frequency", "grid", *fields, "r", "phase", "bandwidth", "xstddev"):
            lines.append(
                f"{k};{148203983402 + k};{len(f)};{name};" + ";".join(f"{x:.12g}" for x in values[name])
            )
    return "\n".join(lines) + "\n"


S = 0.05 / (1 + 2j * np.pi * (F - 32300) * TAU)


def test_labone_s_sweeps_read_with_one_answer(save):
    path = save(labone((F, S), (F[::2], 2 * S[::2])))
    draft = draft_of(path)
    assert asked(draft) == ["quantity"]
    first, second = read_logs(path, columns=save(answered(draft), "map.toml"))
    assert (first.name, second.name) == ("log.csv[0]", "log.csv[1]")
    np.testing.assert_allclose(first.response, np.sqrt(2) * 1j * S, rtol=1e-10)
    np.testing.assert_allclose(second.response, np.sqrt(8) * 1j * S[::2], rtol=1e-10)
    np.testing.assert_allclose(second.frequency, F[::2], rtol=1e-14)
    assert "lies across" in " ".join(first.notes)


def test_a_table_across_with_our_names_needs_no_mapping(save):
    lines = (("# plate", "A7"), ("frequency_Hz", *F), ("wd_um", *S.real), ("wq_um", *S.imag))
    text = "# plate: A7\n" + "".join(",".join(map(str, line)) + "\n" for line in lines[1:])
    (log,) = read_logs(save(text))
    assert (log.metadata["plate"], log.kind) == ("A7", "steady")
    np.testing.assert_allclose(log.response, S, rtol=1e-14)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[:-40], ["line 9", "found", "expected 201 as in line", "still being written"]),
        (lambda t: t.replace(";y;", ";x;"), ["line 5", "'x' again", "line 4"]),
        (lambda t: t.replace(";y;", ";;"), ["line 5", "the name of a quantity"]),
        (lambda t: t.replace("x;" + f"{S[0].real:.12g}", "x;OL"), ["line 4, cell 5", "'x'", "'OL'"]),
        (
            lambda t: t + "1;2;201;frequency;" + ";".join(map(str, F)) + "\n",
            ["line 10", "other quantities", "grid"],
        ),
        (
            lambda t: t.replace("phase;", "phase;;"),
            ["line 2", "found 201 numbers", "expected 202 as in line 7"],
        ),
    ],
)
def test_a_table_across_that_is_broken_is_refused_by_line(save, change, words):
    path = save(labone((F, S)))
    columns = save(answered(draft_of(path)), "map.toml")
    refused(save(change(labone((F, S)))), *words, columns=columns)


# A channel a file

TIME = 1e-6 * np.arange(4000)
CARRIER = np.sin(2 * np.pi * 40e3 * TIME)
CHANNELS = 'kind = "waveform"\nquantity = "displacement"\n[columns]\ntime = { column = 0, unit = "s" }\n'
CHANNELS += 'drive = { column = "Volt", unit = "V", file = "*CH1.csv" }\n'
CHANNELS += 'response = { column = "Volt", unit = "V", file = "*CH2.csv" }\n'


def channel(values, time=TIME):
    return "Second,Volt\n" + "".join(
        f"{a!r},{b!r}\n" for a, b in zip(time.tolist(), values.tolist(), strict=True)
    )


def test_two_files_of_one_capture_are_read_side_by_side(save):
    for k, gain in ((1, 0.1), (2, 0.2)):
        save(channel(CARRIER), f"F000{k}CH1.CSV")
        path = save(channel(gain * CARRIER), f"F000{k}CH2.CSV")
    logs = read_logs(str(path.parent / "F*.CSV"), columns=save(CHANNELS, "map.toml"))
    assert [log.name for log in logs] == ["F0001CH1.CSV", "F0002CH1.CSV"]
    for log, gain in zip(logs, (0.1, 0.2), strict=True):
        assert log.frequency[2] == pytest.approx(40e3, rel=1e-6)  # of 160 periods, free of noise
        np.testing.assert_allclose(np.abs(log.response[1:-1] / log.drive[1:-1]), gain, rtol=1e-6)
        assert "read side by side: F000" in " ".join(log.notes)


def test_the_draft_of_one_channel_names_both_files(save):
    path = save(channel(CARRIER), "scope_CH1_003.csv")
    other = save(channel(0.1 * CARRIER), "scope_CH2_003.csv")
    draft = refused(path).mapping
    assert 'file = "*CH1*.csv"' in draft and 'file = "*CH2*.csv"' in draft
    (log,) = read_logs([other, path], columns=save(answered(draft), "map.toml"))
    np.testing.assert_allclose(np.abs(log.response[1:-1] / log.drive[1:-1]), 0.1, rtol=1e-6)


def test_files_that_are_no_capture_are_refused(save):
    first, columns = save(channel(CARRIER), "aCH1.csv"), save(CHANNELS, "map.toml")
    refused([first], "aCH1.csv", "no file *CH2.csv", columns=columns)
    refused([first, save("1,2\n", "b.csv")], "map.toml", "b.csv", "none of them", "*CH1.csv", columns=columns)
    second = save(channel(CARRIER[:3900], TIME[:3900]), "aCH2.csv")
    refused([first, second], "4000 rows in aCH1.csv", "3900 rows in aCH2.csv", columns=columns)
    save(channel(CARRIER, TIME + 1e-8), "aCH2.csv")
    refused([first, second], "aCH2.csv, line 2", "'Second'", "1e-08", "aCH1.csv, line 2", columns=columns)
    save(channel(CARRIER).replace("\n3e-06,0.6", "\n3e-06,x0.6"), "aCH2.csv")
    refused([first, second], "aCH2.csv, line 5", "'Volt'", "expected a finite number", columns=columns)
    refused(
        [first, save(channel(CARRIER), "aCH2.csv"), save("1", "dCH1.csv")],
        "dCH1.csv",
        "no file",
        columns=columns,
    )
    save(CHANNELS.replace('"Volt", unit = "V", file = "*CH2', '"Vlot", unit = "V", file = "*CH2'), "map.toml")
    refused([first, second], "map.toml", "[columns] response", "did you mean 'Volt'", columns=columns)


@pytest.mark.parametrize("first", ["-1e-6,,\n", "-1e-6,,0.1\n", "-1e-6,0.1,\n"])
@pytest.mark.parametrize(
    "above",
    ["x-axis,1,2\nsecond,Volt,Volt\n", "Time (s),CH1 (V),CH2 (V)\n", "Source,CH1,CH2\nTime (s),Volt,Volt\n"],
)
def test_a_first_row_with_an_empty_cell_is_left_out(save, above, first):
    rows = "".join(f"{a!r},{b!r},{0.1 * b!r}\n" for a, b in zip(TIME.tolist(), CARRIER.tolist(), strict=True))
    path = save(above + first + rows)
    (log,) = read_logs(path, columns=save(answered(refused(path).mapping), "map.toml"))
    np.testing.assert_allclose(np.abs(log.response[1:-1] / log.drive[1:-1]), 0.1, rtol=1e-6)
    assert "1 of 4001 rows left out" in " ".join(log.notes)


@pytest.mark.parametrize("seed", range(40))
def test_hostile_variants_are_read_or_refused_by_name(save, seed):
    """Truncated, of unequal lengths, lines doubled or dropped: a log, or a LogError that names the file."""
    rng = np.random.default_rng(seed)
    text = [raw_4294a(Z), named_4294a(Z), blocks_e4990a(Z), labone((F, S), (F[:50], S[:50])), one_table(Z)][
        seed % 5
    ]
    lines = text.splitlines(keepends=True)
    for _ in range(3):
        a, b = sorted(rng.integers(0, len(lines), 2).tolist())
        kind = rng.integers(0, 5)
        half = [lines[a][: len(lines[a]) // 2]]
        variants = (
            lines[:b],
            lines[:a] + lines[b:],
            lines[:b] + lines[a:],
            lines[:a] + half + lines[a + 1 :],
            [*lines, *lines[: b + 1]],
        )
        lines = variants[kind] or lines
    path = save("".join(lines))
    columns = None
    for _ in range(2):
        try:
            logs = read_logs(path, columns=columns)
        except LogError as error:
            assert "log.csv" in str(error) or "map.toml" in str(error)
            if error.mapping is None:
                break
            columns = save(answered(error.mapping), "map.toml")
        else:
            assert all(np.isfinite(log.response).all() for log in logs)
            break
