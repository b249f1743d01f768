"""What public functions say of what they were not asked for: what was found, and what was expected."""

from dataclasses import replace

import numpy as np
import pytest

import controller
import sysid
from sysid.asked import every, given, number
from sysid.command.arguments import effects as commanded
from sysid.effects.registry import EVERY, chosen

SCENE = sysid.Scene(
    sysid.Plant(0.02, 1.67e-3, 32300.0, None),
    {"drive": sysid.Profile.constant(1.0), "frequency": sysid.Profile.constant(32300.0)},
    10,
    1e4,
)
LOG, FIT, LOOP = (
    "expected a Log, of those that sysid.read_logs",
    "expected a Fit, which",
    "expected a Loop, which",
)


def test_numbers_that_cannot_be_are_refused_and_not_the_log(made):
    """A reference of nan degC was a frequency of nan in the user's file."""
    log = made["fit"].logs[0].log
    for at in (np.nan, np.inf, -400.0):
        with pytest.raises(
            ValueError, match=f"reference_temperature = {at:g}, expected degC, above absolute"
        ):
            sysid.fit(log, reference_temperature=at)
    with pytest.raises(ValueError, match="seed = -1, expected a whole number from 0 on"):
        sysid.sample(made["fit"], seed=-1)


@pytest.fixture(scope="module")
def made(joint_fit):
    fit = joint_fit("plate")
    posterior = sysid.sample(fit, accuracy="quick")
    return {"fit": fit, "posterior": posterior, "loop": controller.design(posterior)}


@pytest.mark.parametrize(
    ("call", "found", "expected"),
    [
        (lambda m: sysid.fit("log.csv"), "logs = 'log.csv'", LOG),
        (lambda m: sysid.fit(["log.csv"]), "one of logs = 'log.csv'", LOG),
        (
            lambda m: sysid.fit(m["fit"].logs[0].log, priors=["tau"]),
            "priors of the type list",
            "by name, as in",
        ),
        (
            lambda m: sysid.fit(m["fit"].logs[0].log, priors={"tau": 1e-3}),
            "the prior of tau = 0.001",
            "standard deviation",
        ),
        (lambda m: sysid.fit([], reference_temperature="24"), "reference_temperature = '24'", "a number"),
        (lambda m: sysid.sample(m["posterior"]), "fit of the type Posterior", FIT),
        (lambda m: sysid.sample(m["fit"], budget="5"), "budget = '5'", "expected a number"),
        (lambda m: sysid.sample(m["fit"], seed="5"), "seed = '5'", "expected a whole number"),
        (lambda m: sysid.fit(m["fit"].logs[0].log, start=3), "start = 3", "expected a sysid.Plant"),
        (lambda m: sysid.advise(m["posterior"]), "fit of the type Posterior", FIT),
        (lambda m: sysid.advise(m["fit"], design=m["loop"]), "design of the type Loop", "controller.design"),
        (lambda m: sysid.advise(m["fit"], drive="100"), "drive = '100'", "expected a number"),
        (lambda m: sysid.advise(m["fit"], temperatures=["24"]), "one of temperatures = '24'", "degC"),
        (lambda m: sysid.compare([m["fit"]]), "fit of the type list", FIT),
        (lambda m: sysid.nuisances(None), "fit = None", FIT),
        (lambda m: sysid.compare_fits(m["fit"], 3), "fit = 3", "a fit, a posterior, a fit.json"),
        (lambda m: sysid.read_logs(3), "paths = 3", "the path of a file"),
        (lambda m: sysid.write_log("a.csv", m["fit"].logs[0].log), "log = 'a.csv'", LOG),
        (lambda m: m["fit"].predict("a.csv"), "log = 'a.csv'", LOG),
        (lambda m: sysid.Log.from_frame("a.csv"), "a table = 'a.csv'", "sysid.read_logs(path)"),
        (lambda m: sysid.Log.from_waveform([1.0], [1.0], "1 MHz"), "rate = '1 MHz'", "expected a number"),
        (lambda m: sysid.fit_fleet(3), "logs = 3", "files, folders or Logs"),
        (lambda m: controller.design("log.csv"), "source = 'log.csv'", "a posterior, a fit, or a plant"),
        (lambda m: controller.design(m["fit"], rig="rig.toml"), "rig = 'rig.toml'", "Rig.from_toml"),
        (
            lambda m: controller.closed_loop(m["loop"], "a.toml"),
            "one of scenes = 'a.toml'",
            "Scene.from_toml",
        ),
        (
            lambda m: controller.closed_loop(m["loop"], SCENE, [1.0, 2.0]),
            "reference of the type list",
            "a number, or a sysid.Profile",
        ),
        (lambda m: controller.export_c(m["posterior"], "x.h"), "loop of the type Posterior", LOOP),
        (lambda m: controller.as_dict(m["fit"]), "loop of the type Fit", LOOP),
        *(
            (
                lambda m, name=name: controller.design(m["fit"], **{name: "1e-4"}),
                f"{name} = '1e-4'",
                "a number",
            )
            for name in (
                "sample_time",
                "latency",
                "bandwidth_hz",
                "settling_time",
                "amplitude",
                "voltage_limit",
                "finger",
            )
        ),
    ],
)
def test_another_kind_is_refused_by_name(made, call, found, expected):
    with pytest.raises(TypeError) as error:
        call(made)
    assert f"found {found}" in str(error.value) and expected in str(error.value), error.value


@pytest.mark.parametrize("name", ["warming", "frequency_window"])
@pytest.mark.parametrize("value", [3.0, ("a", "b"), (2.0, 1.0)])
def test_a_span_is_two_numbers(made, name, value):
    with pytest.raises(ValueError, match=f"found {name} = .*expected two numbers, from and to"):
        controller.design(made["fit"], **{name: value})


def test_arrays_of_words_are_no_log():
    with pytest.raises(
        sysid.LogError, match=r"found drive of str\d+, for example \['100 V'\], expected numbers"
    ):
        sysid.Log.from_arrays([1.0 + 1j, 2.0], drive="100 V", frequency=32300.0)


def test_advice_on_k_T_without_a_thermometer_says_so(bench):
    fit = sysid.fit(replace(bench.sweep(), temperature=None))
    with pytest.raises(ValueError, match=r"no temperature in any log.*record sweeps at two temperatures"):
        sysid.advise(fit, "k_T")


def test_numbers_of_all_libraries_are_numbers():
    for value in (1, 1.0, True, np.float32(1.0), np.array(1.0)):
        assert number("x", value) == 1.0
    assert every("x", (2, 3), int, "whole numbers") == [2, 3] and every("x", 2, int, "whole numbers") == [2]
    given("x", None, int | None, "a whole number, or nothing")


@pytest.mark.parametrize(
    ("effects", "names"),
    [
        ("-late", set(EVERY) - {"late"}),
        ("-late,+drift", set(EVERY) - {"late"} | {"drift"}),
        (["-late", "+drift"], set(EVERY) - {"late"} | {"drift"}),
        (("rotation", "offset"), {"rotation", "offset"}),
        ("none", set()),
        ([], set()),
    ],
)
def test_effects_are_named_as_by_the_command(effects, names):
    assert set(chosen(effects)) == names
    if isinstance(effects, str):
        assert commanded(effects) == chosen(effects)


def test_a_fit_is_told_its_effects_as_the_command_is(joint_fit):
    log = joint_fit("plate").logs[0].log
    told = sysid.fit(log, effects="rotation,offset")
    assert told.modes[0].trials[0].nuisances == ("rotation", "offset")
    assert told.parameters["tau"] == sysid.fit(log, nuisances=["rotation", "offset"]).parameters["tau"]
    with pytest.raises(ValueError, match="found lat, expected some of rotation"):
        sysid.fit(log, effects="-lat")
    with pytest.raises(ValueError, match="expected one of them"):
        sysid.fit(log, effects="-late", nuisances=["late"])
    with pytest.raises(ValueError, match='say effects="-late"'):
        sysid.fit(log, nuisances="-late")


@pytest.mark.parametrize("budget", [-3, float("nan")])
def test_a_budget_is_a_time(made, budget):
    with pytest.raises(ValueError, match=f"found budget = {budget:g}, expected seconds, 0 or more"):
        sysid.sample(made["fit"], budget=budget)
