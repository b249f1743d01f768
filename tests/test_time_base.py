"""Logs without a column of time: samples that are counted, an oscilloscope's increment, a frequency in
radians."""

import numpy as np
import pytest
import reference

import sysid
from sysid.logs.log import LogError
from sysid.logs.read import read_logs

PLANT = reference.Plant(G=0.02, tau=1.6e-3, f0=32300.0, k_T=0.0)
RATE = 1e4
TIME = np.arange(200) / RATE
DRIVE = np.where(TIME < 2e-3, 0.0, 100.0)


def step(header, above="", first=0):
    """A step on the bench, its rows counted from `first`."""
    frequency = np.full(200, 32310.0)
    rng = np.random.default_rng(0)
    clean = reference.ringing(PLANT, TIME, DRIVE, frequency, np.full(200, 24.0))
    rows = clean + 0.002 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
    columns = np.transpose([DRIVE, frequency, rows.real, rows.imag]).tolist()
    return (
        above
        + header
        + "\n"
        + "".join(f"{k},{','.join(map(repr, row))}\n" for k, row in enumerate(columns, first))
    )


HEADER = "sample,voltage_V,frequency_Hz,wd_um,wq_um"


@pytest.mark.parametrize("above", ["# sample_rate_Hz: 10000\n", "# sample_rate_kHz: 10\n"])
def test_samples_that_are_counted_are_a_time_at_a_stated_rate(save, above):
    (log,) = read_logs(save(step(HEADER, above, first=1)))
    np.testing.assert_allclose(log.time, TIME + 1 / RATE, rtol=1e-12)
    assert (
        log.kind == "transient" and "column sample is read as time, at a sample rate of 10000 Hz" in log.notes
    )
    fit = sysid.fit([log])
    assert fit.result.name == "successful", fit.warnings
    for name in ("tau", "f0"):
        assert abs(fit.parameters[name].value - getattr(PLANT, name)) < 4 * fit.parameters[name].std


@pytest.mark.parametrize("name", ["", "index", "#", "n"])
def test_rows_that_are_counted_by_another_name_have_a_time_at_a_stated_rate(save, name):
    """An index that pandas writes has none."""
    (log,) = read_logs(save(step(HEADER.replace("sample", name), "# sample_rate_Hz: 10000\n", first=1)))
    np.testing.assert_allclose(log.time, TIME + 1 / RATE, rtol=1e-12)
    assert not log.warnings and any("is read as time, at a sample rate" in note for note in log.notes)


def bare(text):
    return "\n".join(line.partition(",")[2] if line[0] != "#" else line for line in text.split("\n") if line)


def test_rows_that_nothing_counts_have_a_time_at_a_stated_rate(save):
    """A log of the same rows, but for the column that counts them; one is lost, and its time with it."""
    text = bare(step(HEADER, "# sample_rate_Hz: 10000\n")).split("\n")
    (log,) = read_logs(save("\n".join(text) + "\n"))
    np.testing.assert_allclose(log.time, TIME, rtol=1e-12)
    (warning,) = log.warnings
    assert "found no time; its rows are taken as one every 0.0001 s" in warning
    row = text[12].split(",")
    text[12] = ",".join([*row[:-1], ""])
    (log,) = read_logs(save("\n".join(text) + "\n"))
    np.testing.assert_allclose(log.time, np.delete(TIME, 10), rtol=1e-12)


def test_a_mapping_file_states_the_rate_of_rows_without_a_time(save):
    """As of a structure of MATLAB, whose period is a constant: the draft has its inverse."""
    text = bare(step("k,u,f,a,b", "# Ts: 1e-4\n")) + "\n"
    with pytest.raises(LogError) as refusal:
        read_logs(save(text))
    assert "sample_rate_Hz = 10000  # 1/Ts, in s" in refusal.value.mapping
    mapping = 'amplitude = "peak"\n[columns]\nvoltage = { column = "u", unit = "V" }\n'
    mapping += 'frequency = { column = "f", unit = "Hz" }\nwd = { column = "a", unit = "um" }\n'
    mapping += 'wq = { column = "b", unit = "um" }\n[metadata]\nsample_rate_Hz = 10000\n'
    (log,) = read_logs(save(text), columns=save(mapping, "map.toml"))
    np.testing.assert_allclose(log.time, TIME, rtol=1e-12)
    assert log.kind == "transient" and any("one every 0.0001 s" in note for note in log.notes)
    (log,) = read_logs(save(text), columns=save('kind = "steady"\n' + mapping, "steady.toml"))
    assert log.time is None


def test_settled_points_have_no_time_beside_a_stated_rate(save):
    """Neither those that say so, nor a sweep's."""
    (log,) = read_logs(save(bare(step(HEADER, "# sample_rate_Hz: 10000\n# kind: steady\n")) + "\n"))
    assert log.time is None and log.kind == "steady" and not log.warnings
    swept = "# sample_rate_Hz: 1000\nfrequency_Hz,wd_um,wq_um\n" + "".join(
        f"{100 + k},1,{k}\n" for k in range(9)
    )
    assert read_logs(save(swept))[0].time is None


def test_samples_without_a_rate_are_named(save):
    (log,) = read_logs(save(step(HEADER)))
    assert log.kind == "steady"  # as the contract has it of a log without time
    (warning,) = log.warnings
    assert (
        "log.csv: found no time, and a column 'sample' that counts the rows" in warning
        and "sample_rate_Hz" in warning
    )
    assert warning in sysid.fit([log]).warnings
    assert not read_logs(save(step(HEADER, "# kind: steady\n")))[0].warnings
    swept = "sample,frequency_Hz,wd_um,wq_um\n" + "".join(f"{k},{100 + k},1,{k}\n" for k in range(9))
    assert not read_logs(save(swept))[0].warnings  # a sweep's points may be counted


@pytest.mark.parametrize(
    ("name", "ways"),
    [
        ("t", "call it t_s, t_ms"),
        ("T (ticks)", "call it T_s, T_ms"),
        ("timestamp", "call it timestamp_s, timestamp_ms"),
        ("elapsed", "call it elapsed_s, elapsed_ms"),
    ],
)
def test_a_time_without_a_unit_is_named_where_rows_need_one(save, name, ways):
    """The rows of a step by a time in milliseconds that does not say so: without it they are settled points,
    which no plate explains."""
    text = step(HEADER.replace("sample", name))
    (log,) = read_logs(save(text))
    assert (log.kind, log.time) == ("steady", None)
    (warning,) = log.warnings
    assert f"log.csv: found no time, and a column {name!r} that goes up" in warning
    assert ways in warning and "mapping file (--columns)" in warning and "kind: steady" in warning
    assert f"column {name} is kept out of the fit: it states no unit of time; {ways}" in log.notes
    (read,) = read_logs(save(text.replace(name, ways.split()[-1], 1)))  # as the warning says
    assert read.kind == "transient" and not read.warnings
    assert read.time.tolist() == pytest.approx([k / 1000 for k in range(len(read.time))])


@pytest.mark.parametrize("head", ["t,time_s", "t,sample", "T,note"])
def test_other_columns_of_that_name_are_left_in_peace(save, head):
    """Beside a time; beside rows that are counted, of which that is said; of readings that go up and down."""
    rows = step(HEADER.replace("sample", head)).splitlines()[1:]
    falls = head == "T,note"
    body = "".join(f"{24 - k % 7 * 0.1 if falls else k},{row}\n" for k, row in enumerate(rows))
    (log,) = read_logs(save(f"{HEADER.replace('sample', head)}\n{body}"))
    assert not any("'t'" in warning or "'T'" in warning for warning in log.warnings)
    sweep = "t,frequency_Hz,wd_um,wq_um\n" + "".join(f"{k},{100 + k},1,{k}\n" for k in range(9))
    (log,) = read_logs(save(sweep))
    assert not log.warnings and "call it t_s, t_ms" in log.notes[0]


@pytest.mark.parametrize("name", ["Elapsed Time [ms]", "unix_ms", "Horodatage (ms)", "since trigger in ms"])
def test_what_goes_up_in_a_unit_of_time_is_one(save, name):
    (log,) = read_logs(save(step(HEADER.replace("sample", name))))
    assert log.kind == "transient" and not log.warnings
    np.testing.assert_allclose(log.time - log.time[0], 1e-3 * np.arange(len(log)), atol=1e-9)
    assert f"column {name} is read as time, by its unit and as it goes up" in log.notes


def test_a_period_beside_frequencies_is_no_time(save):
    head = "{} (ms),frequency_Hz,wd_um,wq_um\n"
    rows = "".join(f"{1e3 / (200 - k)!r},{200 - k},1,{k}\n" for k in range(9))
    assert read_logs(save(head.format("period") + rows))[0].time is None
    assert read_logs(save(head.format("elapsed time") + rows))[0].time is not None


@pytest.mark.parametrize("rate", ["0", "-5", "x"])
def test_a_rate_that_is_none_is_refused(save, rate):
    with pytest.raises(LogError, match="sample_rate_Hz"):
        read_logs(save(step(HEADER, f"# sample_rate_Hz: {rate}\n")))


@pytest.mark.parametrize("name", ["omega_rad/s", "Omega [rad/s]", "ω (rad/s)"])
def test_a_frequency_in_radians_is_read_as_one(save, name):
    text = f"{name},voltage_V,wd_um,wq_um\n" + "".join(
        f"{2 * np.pi * (100 + k)!r},1,1,{k}\n" for k in range(9)
    )
    (log,) = read_logs(save(text))
    np.testing.assert_allclose(log.frequency, 100.0 + np.arange(9), rtol=1e-14)
    assert f"column {name} is read as frequency" in log.notes


def test_omega_in_hertz_is_kept_out(save):
    (log,) = read_logs(save("omega_Hz,voltage_V,w_um\n" + "".join(f"{100 + k},{k},{k}\n" for k in range(9))))
    assert log.frequency is None


@pytest.mark.parametrize(("end", "last"), [("", ",,"), ("", ","), (",", ",,,")])
def test_an_oscilloscope_s_increment_is_its_time_base(save, end, last):
    """Rigol's export: what Start and Increment are stands among the units, and the rows end in empty
    cells."""
    time = np.arange(12000) * 1e-6
    drive = np.where(time < 1e-3, 0.0, np.sin(2 * np.pi * 40e3 * time))
    rows = "".join(f"{k},{a:.6e},{a / 10:.6e}{last}\n" for k, a in enumerate(drive.tolist()))
    above = f"X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-1.000000e-03,1.000000e-06{end}\n"
    path = save(above + rows)
    with pytest.raises(LogError, match="no response") as error:
        read_logs(path)
    draft = error.value.mapping
    assert 'drive = { column = "CH1_Volt", unit = "V" }' in draft and "sample_rate_Hz" not in draft
    (log,) = read_logs(
        path, columns=save(draft.replace('quantity = "?"', 'quantity = "displacement"'), "map.toml")
    )
    assert "sampled every 1e-06 s" in " ".join(log.notes)
    np.testing.assert_allclose(log.frequency[log.drive != 0], 40e3, rtol=1e-6)
    assert abs(log.time[-1] - time[-1]) < 1e-4


def test_what_no_log_bounds_is_looked_at_broadly_and_not_sampled(save):
    """A step read as settled points bounds nothing, though its result is a misfit: tau was drawn from a normal
    of millions in its logarithm, and was infinite. No rung is offered above."""
    fit = sysid.fit(read_logs(save(step(HEADER.replace("sample", "t")))))
    posterior = sysid.sample(fit, accuracy="quick")
    assert fit.result.bounded and posterior.offer() is None
    assert all(np.isfinite(draws).all() for draws in posterior.draws.values())
    assert all(np.isfinite(told.rhat) for told in posterior.convergence.values())
