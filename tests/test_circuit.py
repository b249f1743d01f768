"""The equivalent circuit: of admittances in closed form, with noise, read and fitted as any file; loaded Q
against a half-power width and against scikit-rf.

The circuits are those of a Langevin transducer, of a plate with patches, and of a quartz of 10 MHz."""

import io
import json
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from conftest import most, seeds

import sysid
from sysid.command import outputs
from sysid.command.sets import described
from sysid.posterior.circuit import QUANTITIES
from sysid.report import html, screen, text
from sysid.tables.scattered import admittance, steepness


class Branches(NamedTuple):
    R1: float
    L1: float
    C1: float
    C0: float
    tan_d: float

    def admittance(self, frequency, rng=None, noise=0.002):
        """Y, S; with noise that is a fraction of it."""
        s = 2j * np.pi * frequency
        Y = 1 / (self.R1 + s * self.L1 + 1 / (s * self.C1)) + s * self.C0 * (1 - 1j * self.tan_d)
        return Y if rng is None else Y * (1 + noise * complex_noise(rng, len(Y)))

    @property
    def omega(self):
        return 1 / np.sqrt(self.L1 * self.C1)

    @property
    def Q(self):
        return self.omega * self.L1 / self.R1

    def sweep(self, rows=401, widths=12):
        """Frequencies about the resonance, Hz."""
        f = self.omega / (2 * np.pi)
        return f * (1 + widths / self.Q * np.linspace(-0.5, 0.5, rows))

    @property
    def truth(self):
        """All that is reported, in closed form; f_p is where the susceptance of the lossless circuit vanishes."""
        f_s, C = self.omega / (2 * np.pi), self.C0 * self.C1 / (self.C0 + self.C1)
        f_p = 1 / (2 * np.pi * np.sqrt(self.L1 * C))
        derived = {"G_s": 1 / self.R1, "f_s": f_s, "f_p": f_p, "k_eff": np.sqrt(1 - (f_s / f_p) ** 2)}
        return self._asdict() | derived | {"figure_of_merit": self.Q * self.C1 / self.C0}


def complex_noise(rng, count):
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)


LANGEVIN = Branches(20.0, 0.0568, 5.7e-10, 4e-9, 0.004)
PLATE = Branches(2000.0, 1.669041, 1.4546738e-11, 2e-9, 0.005)
QUARTZ = Branches(12.0, 9.6e-3, 26.385e-15, 5e-12, 0.001)
CIRCUITS = {"langevin": LANGEVIN, "plate": PLATE, "quartz": QUARTZ}
MAP = 'quantity = "impedance"\n[columns]\nfrequency = "f_Hz"\nx = "R_ohm"\ny = "X_ohm"\n'
SHOWS_S = 'quantity = "current"\nphase_sign = 1\n[columns]\nfrequency = "f_Hz"\nx = "G_S"\ny = "B_S"\n'


def rows(head, *columns):
    return (
        head + "\n" + "".join(",".join(f"{x:.12g}" for x in row) + "\n" for row in zip(*columns, strict=True))
    )


def circuit(log, **options):
    return sysid.sample(sysid.fit(log, **options), accuracy="quick").circuit


def measured(save, of, seed=0):
    """The log of an impedance, by its file."""
    f = of.sweep()
    Z = 1 / of.admittance(f, np.random.default_rng(seed))
    return sysid.read_logs(save(rows("f_Hz,R_ohm,X_ohm", f, Z.real, Z.imag)), columns=save(MAP, "map.toml"))


@pytest.mark.parametrize("name", CIRCUITS)
@seeds(4, 40)
def test_errors_hold_the_truth(save, name, seeds):
    of, z = CIRCUITS[name], []
    for seed in seeds:
        found = circuit(measured(save, of, seed)).parameters
        assert list(found) == list(QUANTITIES)
        z += [[(found[n].value - true) / found[n].std for n, true in of.truth.items()]]
    assert np.sqrt(np.mean(np.square(z))) < most(seeds)  # at most five of nine numbers are independent
    assert np.max(np.abs(z)) < 4.5


def test_numbers_are_as_exact_as_the_noise_lets_them_be(save):
    """Errors by the information of the five numbers in closed form, of weighted least squares: the fit, which
    leaves a turn and a slope of the background open besides, is not far above."""
    of, f = LANGEVIN, LANGEVIN.sweep()

    def model(x):
        Y = Branches(*x).admittance(f) / of.admittance(f)
        return np.r_[Y.real, Y.imag]

    x = np.array(of)
    J = np.stack([(model(x * (1 + d)) - model(x * (1 - d))) / 2e-5 for d in 1e-5 * np.eye(5)], 1) / x
    best = 0.002 * np.sqrt(np.diag(np.linalg.inv((J * x).T @ (J * x)))) * x
    found = circuit(measured(save, of)).parameters
    for name, error in zip(Branches._fields, best, strict=True):
        assert 0.9 < found[name].std / error < 3.0, name


def test_correlations_are_those_of_the_circuit(save):
    """L1 C1 is known as well as f_s; what follows from one draw of them follows together."""
    found = circuit(measured(save, LANGEVIN))
    index = {name: k for k, name in enumerate(found.names)}
    r, p = found.correlation, found.parameters
    np.testing.assert_allclose(np.diag(r), 1.0, rtol=1e-12)
    np.testing.assert_allclose(r, r.T)
    L, C = (p[n].std / p[n].value for n in ("L1", "C1"))
    product = np.sqrt(L**2 + C**2 + 2 * L * C * r[index["L1"], index["C1"]])
    assert product == pytest.approx(2 * p["f_s"].std / p["f_s"].value, rel=0.05)


@pytest.mark.parametrize("volts", ["1 V", "0.5 V", "20 mV", "1 V_rms"])
def test_the_level_of_the_analyser_does_not_matter(save, volts):
    f = LANGEVIN.sweep()
    Y = LANGEVIN.admittance(f, np.random.default_rng(0))
    given = SHOWS_S + f'[constants]\nvoltage = "{volts}"\n'
    found = circuit(sysid.read_logs(save(rows("f_Hz,G_S,B_S", f, Y.real, Y.imag)), save(given, "map.toml")))
    for name, true in LANGEVIN.truth.items():
        p = found.parameters[name]
        assert abs(p.value - true) < 4 * p.std, name


@pytest.mark.parametrize(("unit", "volt"), [("A", 1.0), ("mA", 1.0), ("A", 0.1)])
def test_a_current_under_a_voltage_and_a_lock_in_that_turns_it(save, unit, volt):
    """A phase that is not calibrated turns all that is seen; tan d is right in the plate's frame."""
    f = PLATE.sweep()
    current = volt * PLATE.admittance(f) * np.exp(0.3j)
    current = current + 0.002 * np.max(np.abs(current)) * complex_noise(np.random.default_rng(1), len(f))
    current = current / {"A": 1.0, "mA": 1e-3}[unit]
    given = 'quantity = "current"\namplitude = "peak"\nphase_sign = 1\n[columns]\nfrequency = "f_Hz"\n'
    given += f'x = "X_{unit}"\ny = "Y_{unit}"\n[constants]\nvoltage = "{volt} V"\n'
    text_ = rows(f"f_Hz,X_{unit},Y_{unit}", f, current.real, current.imag)
    found = circuit(sysid.read_logs(save(text_), save(given, "map.toml"))).parameters
    for name, true in PLATE.truth.items():
        assert abs(found[name].value - true) < 4 * found[name].std, name


@pytest.mark.parametrize("name", CIRCUITS)
@pytest.mark.parametrize(("unit", "volt"), [("S", 1.0), ("S", 0.5), ("A", 0.5), ("mA", 0.5)])
def test_columns_of_the_contract_s_names(name, unit, volt):
    """An admittance or a current that is written as the response itself, which is a conductance at resonance."""
    of = CIRCUITS[name]
    f = of.sweep()
    W = of.admittance(f) + 2e-4 / of.R1 * complex_noise(np.random.default_rng(2), len(f))
    W = W * {"S": 1.0, "A": volt, "mA": 1e3 * volt}[unit]
    found = circuit(sysid.Log.from_arrays(W, drive=volt, frequency=f, response_unit=unit)).parameters
    for number, true in of.truth.items():
        assert abs(found[number].value - true) < 4 * found[number].std + 1e-6 * true, number


def test_admittances_at_several_levels_written_as_they_are_tell_no_circuit():
    f = QUARTZ.sweep()
    W = QUARTZ.admittance(f, np.random.default_rng(2))
    logs = [
        sysid.Log.from_arrays(W * v, drive=v, frequency=f, response_unit="S", name=str(v)) for v in (1, 2)
    ]
    found = circuit(logs).parameters
    assert not found["R1"].determined and "several voltages" in found["R1"].why
    assert found["f_s"].determined


def test_several_logs_tell_more_and_logs_that_differ_less(save):
    one = circuit(measured(save, LANGEVIN, 1)).parameters["C0"]
    same = [measured(save, LANGEVIN, seed)[0] for seed in (1, 2, 3, 4)]
    four = circuit(same).parameters["C0"]
    assert four.std == pytest.approx(one.std / 2, rel=0.4)
    assert abs(four.value - LANGEVIN.C0) < 4 * four.std
    warm = [measured(save, LANGEVIN._replace(C0=c), 5)[0] for c in (3.9e-9, 4.1e-9)]
    apart = circuit([*same, *warm]).parameters["C0"]
    assert apart.std > 5 * four.std and abs(apart.value - LANGEVIN.C0) < 4 * apart.std


def without_phase(save, of=LANGEVIN._replace(C0=1e-14), seed=0):  # noqa: B008
    f = of.sweep()
    Y = np.abs(of.admittance(f, np.random.default_rng(seed)))
    given = SHOWS_S.replace('x = "G_S"\ny = "B_S"', 'magnitude = "Y_S"').replace("phase_sign = 1\n", "")
    return sysid.read_logs(save(rows("f_Hz,Y_S", f, Y)), columns=save(given, "map.toml"))


@pytest.mark.study
@seeds(1, 20)
def test_amplitudes_show_C0_by_the_feedthrough_under_them(save, seeds):
    """And hardly its losses: where tan d might be anything, it is absent."""
    z, seen = [], []
    for seed in seeds:
        found = circuit(without_phase(save, LANGEVIN, seed))
        if not found.parameters["C0"].determined:  # nothing was found under this one
            assert "amplitudes alone" in found.parameters["C0"].why
            continue
        seen.append(seed)
        assert set(LANGEVIN.truth) - set(found.names) <= {"tan_d"}
        told = [(found.parameters[n], true) for n, true in LANGEVIN.truth.items() if n in found.names]
        z += [(p.value - true) / p.std for p, true in told]
        loss = found.parameters["tan_d"]
        assert loss.std > 0.01 if loss.determined else "the logs allow tan d from -" in loss.why
    assert len(seen) >= len(seeds) / 2
    assert np.max(np.abs(z)) < 4.5 and np.sqrt(np.mean(np.square(z))) < most(seeds)


def test_it_holds_at_the_reference_temperature(save, nuisances):
    """f_s of a plate that softens by 10 Hz/degC; its other numbers do not depend on the temperature."""
    logs, f = [], LANGEVIN.sweep()
    for seed, warm in enumerate((-6.0, 0.0, 8.0)):
        omega = LANGEVIN.omega - 2 * np.pi * 10 * warm
        of = LANGEVIN._replace(C1=1 / (omega**2 * LANGEVIN.L1))
        Z = 1 / of.admittance(f, np.random.default_rng(seed))
        given = save(MAP + f'[constants]\ntemperature = "{24 + warm} degC"\n', f"{seed}.toml")
        logs += sysid.read_logs(save(rows("f_Hz,R_ohm,X_ohm", f, Z.real, Z.imag), f"{seed}.csv"), given)
    fit = sysid.fit(logs, nuisances=nuisances)
    assert fit.parameters["k_T"].determined and fit.reference_temperature == 24.0
    found = fit.posterior.circuit.parameters
    for name in ("R1", "L1", "C0", "tan_d", "f_s"):
        assert abs(found[name].value - LANGEVIN.truth[name]) < 4 * found[name].std, name
    assert found["C0"].std < 0.002 * LANGEVIN.C0


def test_a_fit_that_tells_no_plate_has_no_numbers():
    f = np.linspace(1e4, 2e4, 50)
    log = sysid.Log.from_arrays(
        complex_noise(np.random.default_rng(0), 50), drive=1.0, frequency=f, response_unit="C"
    )
    found = circuit(log)
    assert found.names == () and found.correlation.shape == (0, 0)
    assert all("is not determined" in p.why for p in found.parameters.values())


LOST = ("C0", "tan_d", "f_p", "k_eff", "figure_of_merit")


@pytest.mark.parametrize(
    ("logs", "options", "words"),
    [
        (without_phase, {}, "amplitudes alone; record both parts"),
        (lambda save: measured(save, QUARTZ._replace(C0=1e-17)), {}, "within five of its errors"),
        (lambda save: measured(save, LANGEVIN._replace(C0=-4e-9)), {}, "no capacitance, -4e+03"),
        (
            lambda save: measured(save, QUARTZ),
            {"nuisances": ("rotation",)},
            "no feedthrough of the drive was fitted",
        ),
    ],
)
def test_what_a_log_does_not_tell_is_absent_with_a_reason(save, logs, options, words):
    found = circuit(logs(save), **options).parameters
    assert [name for name, p in found.items() if not p.determined] == list(LOST)
    for name in LOST:
        assert (found[name].value, found[name].std, found[name].ci95) == (None, None, None)
        assert found[name].why.startswith("cannot tell, because ") and words in found[name].why


def test_other_logs_have_no_circuit():
    f = LANGEVIN.sweep()
    W = LANGEVIN.admittance(f, np.random.default_rng(0))
    for units in (
        {"response_unit": "um"},
        {"response_unit": "degC"},
        {"response_unit": "C", "drive_unit": "A"},
    ):
        log = sysid.Log.from_arrays(W, drive=1.0, frequency=f, **units)
        assert circuit(log) is None


# Network analysers


def touchstone(path, f, S, r):
    """A file of one port (n,) or two (n, 2, 2), in the order of its format."""
    columns = [S] if S.ndim == 1 else [S[:, 0, 0], S[:, 1, 0], S[:, 0, 1], S[:, 1, 1]]
    parts = [part for s in columns for part in (s.real, s.imag)]
    lines = [" ".join(f"{x:.12g}" for x in row) for row in zip(f, *parts, strict=True)]
    path.write_text(f"# Hz S RI R {r:g}\n" + "\n".join(lines) + "\n")
    return path


def scattered(of, f, place, r, rng=None):
    """S parameters that scikit-rf makes of the plate in its place."""
    skrf = pytest.importorskip("skrf")
    band = skrf.Frequency.from_f(f, unit="hz")
    line = skrf.media.DefinedGammaZ0(band, z0=r)
    z = 1 / of.admittance(f, rng)
    plate = line.resistor(z)  # a series element of a complex impedance
    network = {"one": plate ** line.short(), "series": plate, "across": line.shunt(plate ** line.short())}[
        place
    ]
    return network.s[:, 0, 0] if place == "one" else network.s


def half_power_Q(of, behind):
    """Q of the current in the motional branch, whose source is `behind` ohm in parallel with C0: its half-power
    width, counted on a fine grid."""
    f = of.sweep(400_001, 30 * of.Q / 80)
    s = 2j * np.pi * f
    seen = 1 / (1 / behind + s * of.C0 * (1 - 1j * of.tan_d))
    power = 1 / np.abs(of.R1 + s * of.L1 + 1 / (s * of.C1) + seen) ** 2
    peak = int(np.argmax(power))
    inside = f[power > power[peak] / 2]
    return f[peak] / (inside[-1] - inside[0])


@pytest.mark.parametrize(
    ("place", "device", "r", "behind"),
    [
        ("one", "one port", 50.0, 50.0),
        ("one", "one port", 75.0, 75.0),
        ("series", "in series", 50.0, 100.0),
        ("across", "across the line", 50.0, 25.0),
    ],
)
def test_loaded_and_unloaded_Q_of_touchstone_files(tmp_path, place, device, r, behind):
    of = LANGEVIN
    f = of.sweep(801)
    path = tmp_path / f"a.s{1 if place == 'one' else 2}p"
    touchstone(path, f, scattered(of, f, place, r, np.random.default_rng(3)), r)
    found = circuit(sysid.read_logs(path))
    p = found.parameters
    assert (found.reference, found.device) == (r, device)
    assert abs(p["unloaded_Q"].value - of.Q) < 4 * p["unloaded_Q"].std
    assert p["loaded_Q"].value == pytest.approx(half_power_Q(of, behind), rel=0.002)
    assert p["loaded_Q"].std < 0.002 * p["loaded_Q"].value
    # without the capacitance, R/R1: it takes (w C0 R)^2 of that
    assert p["coupling"].value == pytest.approx(
        behind / of.R1 / (1 + (of.omega * of.C0 * behind) ** 2), rel=0.002
    )
    assert p["loaded_Q"].value == pytest.approx(p["unloaded_Q"].value / (1 + p["coupling"].value), rel=0.01)
    for name, true in of.truth.items():
        assert abs(p[name].value - true) < 4.5 * p[name].std, name


SCATTERED = {
    ("one", "parts"): 'quantity = "reflection"\n',
    ("one", "dB"): 'quantity = "reflection"\n[metadata]\nreference_ohm = 75\n',
    ("series", "parts"): 'quantity = "transmission"\n[metadata]\ndevice = "in series"\n',
    (
        "across",
        "dB",
    ): 'quantity = "transmission"\n[metadata]\ndevice = "across the line"\nreference_ohm = 50\n',
}


@pytest.mark.parametrize(("place", "form"), SCATTERED)
def test_a_table_of_s_parameters_is_read_as_the_touchstone_file_of_the_same_numbers(
    save, tmp_path, place, form
):
    of, said = LANGEVIN, SCATTERED[place, form]
    f, r = of.sweep(801), 75.0 if "75" in said else 50.0
    s = scattered(of, f, place, r, np.random.default_rng(3))
    (expected,) = sysid.read_logs(touchstone(tmp_path / f"a.s{1 if place == 'one' else 2}p", f, s, r))
    one = s if place == "one" else s[:, 1, 0]
    decibel = (20 * np.log10(np.abs(one)), np.degrees(np.angle(one)))
    head, columns = ("re,im", (one.real, one.imag)) if form == "parts" else ("dB,deg", decibel)
    names, units = (("x", "y"), ("1", "1")) if form == "parts" else (("magnitude", "phase"), ("dB", "deg"))
    stated = {"frequency": ("f", "Hz")} | dict(
        zip(names, zip(head.split(","), units, strict=True), strict=True)
    )
    lines = [
        f'{name} = {{ column = "{column}", unit = "{unit}" }}' for name, (column, unit) in stated.items()
    ]
    first, mark, rest = said.partition("[metadata]")
    mapping = save("\n".join([first, "[columns]", *lines, mark + rest]), "map.toml")
    (log,) = sysid.read_logs(save(rows(f"f,{head}", f, *columns)), columns=mapping)
    np.testing.assert_allclose(log.response, expected.response, rtol=1e-6)
    assert (log.response_unit, log.drive_unit, log.relative_noise) == ("C", "V", expected.relative_noise)
    assert ("50 ohm" in " ".join(log.notes)) == ("reference_ohm" not in said)
    if form == "parts":
        p, other = circuit(log).parameters, circuit(expected).parameters
        for name in ("loaded_Q", "unloaded_Q", "coupling", "R1", "C0"):
            assert p[name].value == pytest.approx(other[name].value, rel=1e-4), name


@pytest.mark.parametrize("place", ["one", "series", "across"])
def test_the_weights_of_an_admittance_are_how_steeply_it_goes_with_s(place):
    """By differences of the admittance that is read."""
    s = 0.9 * np.exp(1j * np.linspace(0.3, 2.8, 50)) * np.linspace(0.2, 1.0, 50)
    stated = {
        "reference_ohm": "75",
        "device": {"one": "one port", "series": "in series", "across": "across the line"}[place],
    }
    change = (admittance(s + 1e-6, stated, "") - admittance(s - 1e-6, stated, "")) / 2e-6
    np.testing.assert_allclose(steepness(s, stated), np.abs(change), rtol=1e-6)


@pytest.mark.parametrize("place", ["one", "series"])
@seeds(3, 40)
def test_noise_is_even_in_s(tmp_path, place, seeds):
    """A crystal, whose admittance has 25 times the noise at its peak: as noise that is part constant and part in
    proportion it had errors of half of what they are."""
    omega = 2 * np.pi * 1e7
    of = Branches(R1=25.0, L1=3e4 * 25 / omega, C1=1 / (3e4 * 25 * omega), C0=5e-12, tan_d=0.0)
    f, pulls = of.sweep(201, 15), []
    for seed in seeds:
        s, rng = scattered(of, f, place, 50.0), np.random.default_rng(seed)
        s = s + 5e-4 * (rng.standard_normal(s.shape) + 1j * rng.standard_normal(s.shape))
        (log,) = sysid.read_logs(touchstone(tmp_path / f"a.s{1 if place == 'one' else 2}p", f, s, 50.0))
        told = sysid.fit([log]).parameters
        for name, true in (("G", 1 / (25 * omega)), ("tau", 2 * of.L1 / 25)):
            pulls.append((told[name].value - true) / told[name].std)
    assert np.sqrt(np.mean(np.square(pulls))) < most(pulls)


def test_a_preset_and_one_word_read_a_vna_s_table(save):
    of, f = LANGEVIN, LANGEVIN.sweep(801)
    s = scattered(of, f, "one", 50.0)
    table = save(rows("freq[Hz],re:Trc1_S11,im:Trc1_S11", f, s.real, s.imag), "vna.csv")
    mapping = save('preset = "rs-vna"\nquantity = "reflection"\n', "map.toml")
    (log,) = sysid.read_logs(table, columns=mapping)
    np.testing.assert_allclose(log.response, of.admittance(f) / (2 * np.pi * f), rtol=1e-6)


def test_s_parameters_that_tell_no_admittance_are_refused_by_name(save):
    table = save("f,re,im\n1000,0.5,0.1\n1001,1,0\n1002,0.5,-0.1\n", "s.csv")
    columns = 'f = "f"\nx = { column = "re", unit = "1" }\ny = { column = "im", unit = "1" }\n'
    columns = "[columns]\n" + columns.replace('f = "f"', 'frequency = { column = "f", unit = "Hz" }')
    alone = columns.split("x =")[0] + 'magnitude = { column = "re", unit = "1" }\n'
    for said, words in {
        'quantity = "transmission"\n' + columns: ("s.csv", "device", '"in series"', '"across the line"'),
        'quantity = "transmission"\n' + columns + '[metadata]\ndevice = "in series"\n': ("row 1", "1+0j"),
        'quantity = "reflection"\n' + columns + "[metadata]\nreference_ohm = -1\n": ("reference_ohm", "-1"),
        'quantity = "reflection"\n' + columns + '[constants]\nvoltage = "2 V"\n': ("no drive",),
        'quantity = "reflection"\n' + columns.replace('"1"', '"V"'): ("'V'", "expected 1, % or dB"),
        'quantity = "reflection"\n' + alone: ("magnitude alone",),
    }.items():
        with pytest.raises(sysid.LogError) as refused:
            sysid.read_logs(table, columns=save(said, "map.toml"))
        assert all(word in str(refused.value) for word in words), refused.value


def test_loaded_and_unloaded_Q_agree_with_scikit_rf(tmp_path):
    skrf = pytest.importorskip("skrf")
    from skrf.qfactor import Qfactor

    of = LANGEVIN
    f = of.sweep(801)
    s = scattered(of, f, "one", 50.0)
    fitted = Qfactor(skrf.Network(f=f, f_unit="hz", s=s[:, None, None]), res_type="reflection")
    fitted.fit()
    p = circuit(sysid.read_logs(touchstone(tmp_path / "a.s1p", f, s, 50.0))).parameters
    assert p["loaded_Q"].value == pytest.approx(fitted.Q_L, rel=0.002)
    assert p["unloaded_Q"].value == pytest.approx(fitted.Q_unloaded(), rel=0.002)


# What is shown of it


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    def save(text_, name="log.csv"):
        path = tmp_path_factory.mktemp("circuit") / name
        path.write_text(text_)
        return path

    posterior = sysid.sample(sysid.fit(measured(save, QUARTZ)), accuracy="quick")
    return posterior, described(posterior, None, ())


def test_fit_json_holds_it_by_its_schema(results):
    jsonschema = pytest.importorskip("jsonschema")
    posterior, content = results
    path = Path(outputs.__file__).parents[1] / "report" / "fit.schema.json"
    written = json.loads(outputs.to_json(content))
    jsonschema.Draft202012Validator(json.loads(path.read_text())).validate(written)
    told = written["derived"]["circuit"]
    assert told["correlation"]["names"] == list(QUANTITIES)
    assert np.shape(told["correlation"]["matrix"]) == (10, 10)
    assert told["parameters"]["L1"]["value"] == posterior.circuit.parameters["L1"].value
    assert {p["unit"] for p in told["parameters"].values()} == {"S", "ohm", "H", "F", "1", "Hz"}
    assert (told["device"], told["reference_ohm"]) == (None, None)
    assert described(posterior, None, ())["derived"] == content["derived"]  # the same draws


def test_it_shows_itself_in_python(results):
    found = results[0].circuit
    frame, said = found.to_frame(), repr(found)
    assert list(frame.index) == list(QUANTITIES) and frame.loc["C0", "unit"] == "F"
    assert len(said.splitlines()) <= 12 and "fF" in said and "G at resonance" in said


def test_the_screen_and_the_report_speak_in_the_units_of_the_trade(results):
    posterior, content = results
    content = content | {"files": {}}
    file = io.StringIO()
    screen.show(content, text.derived(posterior.draws, content["parameters"]), Path("out"), file)
    page = html.render(content, posterior, figures=())
    lines = file.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    block = "\n".join(lines)[block_start(lines) :]
    for name, unit in (("R1", "ohm"), ("L1", "mH"), ("C1", "fF"), ("C0", "pF"), ("f_p", "Hz")):
        assert any(name in line and f"{unit} " in f"{line} " for line in block.splitlines()), name
        assert f">{name}<" in page.replace("\n", "") or f">{name}" in page, name
    for said in (file.getvalue(), page):
        assert "S*s" not in said and "A*s" not in said and " C/V" not in said
    peak = next(line for line in lines if line.startswith("G at resonance")).split()
    assert peak[-1] == "mS" and float(peak[3]) == pytest.approx(1e3 / QUARTZ.R1, rel=0.01)
    assert sum(line.startswith("G ") for line in lines) == 1 and ">G at resonance" in page
    assert "Equivalent circuit" in page and "figure of merit" in page and "Correlation of the circuit" in page


@pytest.mark.parametrize("unit", ["C", "A", "S"])
def test_the_bench_of_an_admittance_is_one(unit):
    """Beside the branch lies jw C0, whatever a log shows of it."""
    of, f = LANGEVIN, LANGEVIN.sweep()
    response = of.admittance(f, np.random.default_rng(0)) / (2 * np.pi * f if unit == "C" else 1.0)
    log = sysid.Log.from_arrays(response, drive=1.0, frequency=f, response_unit=unit, relative_noise=True)
    posterior = sysid.sample(sysid.fit(log), accuracy="quick")
    page = html.render(described(posterior, None, []), posterior)
    table = page.split('aria-label="What the bench added to each log"')[1].split("</table>")[0]
    heads = re.findall(r'<th scope="col">([^<]*)', table)
    cells = dict(zip(heads[1:], re.findall(r"<td[^>]*>([^<]*)", table), strict=True))
    number, unit_ = re.fullmatch(r"(\S+) ± \S+ (\S+)", cells["feedthrough q"]).groups()
    # uS; the model of a current, which is no charge, holds half of C1 in its branch
    beside = 1e6 * of.omega * (of.C0 - (0.0 if unit == "C" else of.C1 / 2))
    assert unit_ == "uS" and float(number) == pytest.approx(beside, rel=0.02)
    assert cells["slope q"].endswith(" S/Hz") and "/V" not in table


def block_start(lines):
    return "\n".join(lines).index("\ncircuit ")


def test_the_screen_says_once_why_numbers_are_missing(save):
    posterior = sysid.sample(sysid.fit(without_phase(save)), accuracy="quick")
    content, file = described(posterior, None, ()) | {"files": {}}, io.StringIO()
    screen.show(content, text.derived(posterior.draws, content["parameters"]), Path("out"), file)
    said = " ".join(file.getvalue().split())
    assert said.count("the logs hold amplitudes alone") == 1
    assert "C0, tan d, f_p, k_eff and figure of merit: cannot tell" in said


@pytest.mark.parametrize("stated", ["temperature_degC: 35.5", "Temperature: 35.5 degC"])
def test_comments_of_a_touchstone_file_state_what_was_constant(tmp_path, stated):
    f = np.linspace(4.99e6, 5.01e6, 101)
    path = touchstone(tmp_path / "a.s1p", f, 0.5 * np.exp(1j * (f - 5e6) / 1e4), 50.0)
    path.write_text(f"! {stated}\n! VNA: my own\n" + path.read_text())
    (log,) = sysid.read_logs(path)
    assert set(log.temperature) == {35.5}
