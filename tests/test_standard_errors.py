"""A column of standard errors: read in its unit, weighed as weighted least squares do, and believed as to its
ratios alone."""

import numpy as np
import pytest
import reference
from conftest import seeds
from refusal import refused
from scipy.optimize import least_squares

import sysid
from sysid.logs.read import read_logs

PLANT = reference.Plant(G=0.02, tau=1.6e-3, f0=32300.0, k_T=0.0)
FREQUENCY = PLANT.f0 + np.linspace(-600, 600, 121)
NAMES = ("G", "tau", "f0")


def sweep(seed, rows=121, factor=1.0, stated=True, amplitude=False):
    """Settled points whose noise is between 0.1 % and 10 % of the peak, in no order; `factor` of what is
    stated."""
    rng = np.random.default_rng([seed, 31])
    frequency = np.linspace(FREQUENCY[0], FREQUENCY[-1], rows)
    clean = np.exp(0.4j) * reference.steady(PLANT, np.full(rows, 100.0), frequency, np.full(rows, 24.0))
    std = 2.0 * 10 ** rng.uniform(-3, -1, rows)
    noisy = clean + std * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    given = {"std": factor * std} if stated else {}
    noisy = np.abs(noisy) if amplitude else noisy
    return sysid.Log("sweep", noisy, drive=np.full(rows, 100.0), frequency=frequency, kind="steady", **given)


def weighted(log):
    """G, tau and f0 with their errors by least squares with those weights, an angle of the demodulator free,
    the level by the residual."""

    def left(x):
        G, tau, f0, angle = x[0] * 0.02, x[1] * 1.6e-3, 32300 + x[2], x[3]
        model = np.exp(1j * angle) * reference.steady(
            reference.Plant(G=G, tau=tau, f0=f0, k_T=0.0), log.drive, log.frequency, np.full(len(log), 24.0)
        )
        off = (log.response - model) / log.std
        return np.concatenate([off.real, off.imag])

    found = least_squares(left, [1.0, 1.0, 0.0, 0.4], x_scale=[1e-3, 1e-3, 0.1, 1e-3])
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / (2 * len(log) - 4)
    scale = np.array([0.02, 1.6e-3, 1.0])
    values, stds = found.x[:3] * scale + (0, 0, 32300), np.sqrt(np.diag(covariance))[:3] * scale
    return dict(zip(NAMES, zip(values, stds, strict=True), strict=True))


def test_weights_are_those_of_weighted_least_squares_whatever_their_common_factor():
    plain = sysid.fit(sweep(1, stated=False), nuisances=("rotation",))
    for factor in (1.0, 7.0):
        log = sweep(1, factor=factor)
        fit, expected = sysid.fit(log, nuisances=("rotation",)), weighted(log)
        for name in NAMES:
            value, std = expected[name]
            assert fit.parameters[name].value == pytest.approx(value, abs=0.05 * std)
            assert fit.parameters[name].std == pytest.approx(std, rel=0.03)
            assert plain.parameters[name].std > 2 * std  # which rows are good is worth that much


@pytest.mark.parametrize("amplitude", [False, True])
@seeds(10, 40)
def test_errors_are_true(seeds, amplitude):
    z = []
    for seed in seeds:
        fit = sysid.fit(sweep(seed, amplitude=amplitude))
        assert fit.result == "successful", fit.warnings
        z += [(fit.parameters[n].value - getattr(PLANT, n)) / fit.parameters[n].std for n in NAMES]
    # of G and tau of a log the errors go together: two independent numbers of three
    assert (
        abs(np.sqrt(np.mean(np.square(z))) - 1.03) < 2.5 / np.sqrt(2 * 2 * len(seeds))
        and np.max(np.abs(z)) < 4.5
    )


def test_means_of_a_long_log_have_the_errors_of_their_rows():
    """Rows of a plate in two states: every second block is twenty times as noisy."""
    rows = 40_000
    rng = np.random.default_rng(3)
    frequency = np.linspace(FREQUENCY[0], FREQUENCY[-1], rows)
    std = np.where(np.arange(rows) // 500 % 2, 0.4, 0.02)
    clean = reference.steady(PLANT, np.full(rows, 100.0), frequency, np.full(rows, 24.0))
    noisy = clean + std * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    given = {"drive": np.full(rows, 100.0), "frequency": frequency, "kind": "steady"}
    log = sysid.Log("long", noisy, std=std, **given)
    fit, plain = sysid.fit(log), sysid.fit(sysid.Log("long", noisy, **given))
    for name in NAMES:
        assert abs(fit.parameters[name].value - getattr(PLANT, name)) < 4 * fit.parameters[name].std
        assert plain.parameters[name].std > 5 * fit.parameters[name].std


def test_a_step_is_weighed_too(bench):
    quiet = bench.transient(seed=2)
    rng = np.random.default_rng(5)
    std = np.where(np.arange(len(quiet)) % 2, 0.02, 0.6)
    noise = std * (rng.standard_normal(len(quiet)) + 1j * rng.standard_normal(len(quiet)))
    fields = {n: getattr(quiet, n) for n in ("time", "drive", "frequency", "temperature", "sampling")}
    log = sysid.Log("step", quiet.response + noise, std=np.hypot(std, 0.02), **fields)
    fit = sysid.fit(log)
    assert abs(fit.parameters["tau"].value - bench.plant.tau) < 4 * fit.parameters["tau"].std
    assert (
        fit.parameters["tau"].std
        < 0.5 * sysid.fit(sysid.Log("step", log.response, **fields)).parameters["tau"].std
    )


# Reading

F = np.array([31.9, 32.2, 32.3, 32.5])
S = np.array([0.3 + 0.1j, 0.9 - 0.2j, 0.1 - 1.2j, -0.2 - 0.4j])
E = np.array([0.01, 0.02, 0.05, 0.03])
OMEGA = 2e3 * np.pi * F


def table(head, *columns):
    rows = zip(*(c.tolist() for c in columns), strict=True)
    return head + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)


@pytest.mark.parametrize(
    ("head", "columns", "expected"),
    [
        ("frequency_kHz,wd_um,wq_um,std_nm", (F, S.real, S.imag, 1e3 * E), E),
        ("frequency_kHz,w_um,w_std_um", (F, abs(S), E), E),
        ("frequency_kHz,wd_um,wq_um,wd_std_um,wq_std_um", (F, S.real, S.imag, E, 3 * E), E * np.sqrt(5)),
        ("frequency_kHz,wd_um,wq_um,Sigma [um]", (F, S.real, S.imag, E), E),
        ("frequency_kHz,w_um_rms,std_um_rms", (F, abs(S), E), np.sqrt(2) * E),
        ("frequency_kHz,w_um,std_%", (F, abs(S), 100 * E), E * abs(S)),
    ],
)
def test_names_of_the_contract(save, head, columns, expected):
    (log,) = read_logs(save(table(f"# voltage_V: 1\n{head}", *columns)))
    np.testing.assert_allclose(log.std, expected, rtol=1e-12)
    assert "standard errors of the response" in " ".join(log.notes)


RE_IM, POLAR = (S.real, S.imag), (20 * np.log10(abs(S)), np.angle(S))
MAPS = {  # names and units of two columns, their numbers, the unit of the errors, and theirs
    "velocity": (("x", "V"), ("y", "V"), RE_IM, "mV", 1e3 * E, E / OMEGA),
    "displacement": (
        ("magnitude", "dB"),
        ("phase", "rad"),
        POLAR,
        "dB",
        np.full(4, 0.1),
        abs(S) * (10 ** (0.1 / 20) - 1),
    ),
    "impedance": (("x", "kohm"), ("y", "kohm"), RE_IM, "ohm", E, E / (1e6 * abs(S) ** 2 * OMEGA)),
    "charge": (("x", "C"), ("y", "C"), RE_IM, "%", 100 * E, E * abs(S)),
}


@pytest.mark.parametrize("quantity", MAPS)
def test_a_mapping_file_names_them_in_units_of_the_signal(save, quantity):
    first, second, parts, unit, errors, expected = MAPS[quantity]
    text = 'amplitude = "peak"\nphase_sign = 1\n' if quantity != "impedance" else ""
    text += f'quantity = "{quantity}"\n[columns]\nfrequency = {{ column = "f", unit = "kHz" }}\n'
    for column, (name, its) in {"a": first, "b": second, "e": ("std", unit)}.items():
        text += f'{name} = {{ column = "{column}", unit = "{its}" }}\n'
    (log,) = read_logs(save(table("f,a,b,e", F, *parts, errors)), columns=save(text, "map.toml"))
    np.testing.assert_allclose(log.std, expected, rtol=6e-3)  # a tenth of a decibel is no infinitesimal
    assert not log.relative_noise


@pytest.mark.parametrize(
    ("head", "errors", "words"),
    [
        ("frequency_Hz,w_um,std_um", [1.0, 0.0, 2.0], ("line 4", "std_um", "a standard error above zero")),
        ("frequency_Hz,w_um,std_um", [1.0, -1.0, 2.0], ("line 4", "a standard error above zero")),
        ("frequency_Hz,w_um,std_V", [1.0, 1.0, 2.0], ("standard errors in V", "expected um")),
        ("frequency_Hz,w_um,std_um,w_std_um", [1.0, 1.0, 2.0], ("twice",)),
    ],
)
def test_what_cannot_be_a_standard_error_is_refused(save, head, errors, words):
    more = [np.array(errors)] * (len(head.split(",")) - 2)
    refused(
        save(table(f"# voltage_V: 1\n{head}", np.array([1.0, 2, 3]), np.array([1.0, 2, 1]), *more)), *words
    )


def test_a_log_with_them_is_written_and_reads_back(tmp_path):
    log = sweep(4)
    sysid.write_log(log, tmp_path / "a.csv")
    (again,) = read_logs(tmp_path / "a.csv")
    np.testing.assert_array_equal(again.std, log.std)
    np.testing.assert_array_equal(sysid.Log.from_frame(log.to_frame()).std, log.std)
    other = table("frequency_Hz,voltage_V,wd_nm,wq_nm,std_nm", FREQUENCY[:3], *[np.ones(3)] * 4)
    (tmp_path / "b.csv").write_text(other)
    _, second = read_logs([tmp_path / "a.csv", tmp_path / "b.csv"])
    np.testing.assert_allclose(second.std, 1e-3)


def test_what_oscilloscopes_call_so_stays_out(save):
    """Raw samples show their noise themselves."""
    t = np.arange(4000) / 1e6
    columns = (t, np.cos(2e5 * t), np.sin(2e5 * t), 1 + 0 * t)
    (log,) = read_logs(save(table("time_s,drive_V,response_um,std_um", *columns)))
    assert log.std is None and "std_um is kept out" in " ".join(log.notes)
