"""The files of a run: fit.json as promised, draws that xarray opens, and one set in the place of another."""

import errno
import hashlib
import json
import os
import signal
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5netcdf
import jsonschema
import numpy as np
import pytest
import standin
import xarray

from sysid.command import outputs
from sysid.verdict.result import Result

# What every fit.json holds, in its order.
KEYS = [
    "schema",
    "result",
    "usable",
    "verdict",
    "plate",
    "created",
    "parameters",
    "derived",
    "covariance",
    "reference_temperature_degC",
]
KEYS += ["uncertainty", "warnings", "notes", "findings", "logs", "models", "advice", "no_advice", "change"]
KEYS += ["controller", "files", "seed", "versions", "cost"]


def strict(text):
    """JSON as strict readers take it: NaN and Infinity are refused."""
    return json.loads(text, parse_constant=pytest.fail)


def test_fit_json_has_the_promised_keys_in_order():
    content = strict(outputs.to_json(outputs.document(standin.posterior(), {"gains": 1}, ["careful"])))
    assert list(content) == KEYS
    assert content["result"] == "successful" and content["warnings"] == ["careful"] and content["seed"] == 3
    assert list(content["parameters"]) == ["G", "tau", "f0", "k_T"]
    assert list(content["parameters"]["tau"]) == ["value", "std", "ci95", "unit", "determined", "why"]
    assert list(content["logs"][0])[:5] == ["path", "sha256", "kind", "rows", "nrmse_percent"]
    assert set(content["versions"]) == {"python", "sysid", "jax", "optimistix", "emcee", "numpy", "pandas"}


SCHEMA = json.loads(
    (Path(outputs.__file__).parents[1] / "report" / "fit.schema.json").read_text(encoding="utf-8")
)


def holds(content):
    """The content keeps the schema in the package."""
    jsonschema.Draft202012Validator(SCHEMA).validate(json.loads(outputs.to_json(content)))


def test_the_schema_is_one_and_names_every_key():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["required"] == KEYS == list(SCHEMA["properties"])
    assert SCHEMA["properties"]["result"]["enum"] == [r.value for r in Result]


@pytest.mark.parametrize("result", list(Result))
def test_values_are_usable_where_the_run_was_successful(result):
    """Whatever is determined there: the flag is for scripts that look at nothing else."""
    content = outputs.document(standin.posterior(result=result), None, [])
    assert content["usable"] is (content["result"] == "successful")
    assert content["parameters"]["tau"]["determined"]


@pytest.mark.parametrize("result", list(Result))
def test_fit_json_keeps_its_schema_however_it_ended(result):
    holds(
        outputs.document(
            standin.posterior(result=result, missing=("G",), modes=({"value": 1.0},)), None, ["careful"]
        )
    )


@pytest.mark.parametrize(
    ("key", "value"), [("result", "good"), ("parameters", {}), ("extra", 1), ("seed", -1), ("logs", [])]
)
def test_the_schema_refuses_what_is_none_of_ours(key, value):
    content = outputs.document(standin.posterior(), None, []) | {key: value}
    with pytest.raises(jsonschema.ValidationError):
        holds(content)


def test_fit_json_says_in_one_sentence_what_is_determined():
    said = outputs.document(standin.posterior(), None, [])["verdict"]
    assert said == "G, tau and f0 are determined from 2 logs; k_T is not"
    failed = outputs.document(standin.posterior(result=Result.not_converged), None, [])["verdict"]
    assert failed.startswith("the fit did not converge: ")


def test_the_plate_and_the_date_are_said():
    logs = [standin.fitted(metadata={"Plate": "A7"}), standin.fitted("sweep.csv", "steady")]
    content = outputs.document(standin.posterior(logs), None, [])
    assert content["plate"] == "A7" and outputs.document(standin.posterior(), None, [])["plate"] is None
    assert datetime.now(UTC) - datetime.fromisoformat(content["created"]) < timedelta(minutes=5)


def test_covariance_and_derived_quantities_agree_with_the_parameters():
    posterior = standin.posterior()
    content = outputs.document(posterior, None, [])
    names, matrix = content["covariance"]["names"], np.array(content["covariance"]["matrix"])
    assert names == ["G", "tau", "f0"]
    np.testing.assert_allclose(
        np.sqrt(np.diag(matrix)), [content["parameters"][n]["std"] for n in names], rtol=1e-12
    )
    # Q = pi f0 tau, its relative error that of tau: f0's is a thousand times less
    Q, tau = content["derived"]["Q"], content["parameters"]["tau"]
    assert Q["value"] == pytest.approx(np.pi * 32300 * tau["value"], rel=1e-4)
    assert Q["std"] / Q["value"] == pytest.approx(tau["std"] / tau["value"], rel=0.01)
    assert content["derived"]["half_bandwidth"]["value"] == pytest.approx(
        1 / (2 * np.pi * tau["value"]), rel=1e-3
    )


def test_a_parameter_that_is_not_determined_is_null_with_a_reason():
    modes = ({"value": 1.0, "std": np.float64(0.1), "weight": 0.5},) * 2
    content = outputs.document(standin.posterior(modes=modes), None, [])
    k_T = content["parameters"]["k_T"]
    assert (k_T["value"], k_T["std"], k_T["ci95"], k_T["determined"]) == (None, None, None, False)
    assert k_T["why"].startswith("cannot tell") and len(k_T["modes"]) == 2
    assert "modes" not in content["parameters"]["tau"]


def test_what_is_not_finite_is_null():
    content = outputs.document(standin.posterior(ess=float("nan")), None, [])
    assert content["uncertainty"]["ess"] is None
    text = outputs.to_json({"a": np.float64("inf"), "b": [np.int64(3), True], "c": {"d": -np.inf}})
    assert strict(text) == {"a": None, "b": [3, True], "c": {"d": None}}


def test_correlation_in_rows_is_not_called_seconds():
    sweep = standin.fitted("sweep.csv", "steady", noise_time=2.5)  # no time: 2.5 rows
    step = standin.fitted(noise_time=3e-4)
    logs = outputs.document(standin.posterior([sweep, step]), None, [])["logs"]
    assert [log["noise_time_s"] for log in logs] == [None, 3e-4]


def test_draws_open_in_xarray_and_h5netcdf(tmp_path):
    posterior, path = standin.posterior(), tmp_path / "posterior.nc"
    outputs.write_draws(posterior, path)
    with xarray.open_dataset(path, group="posterior", engine="h5netcdf") as found:
        assert dict(found.sizes) == {"chain": 4, "draw": 100} and set(found.data_vars) == {"G", "tau", "f0"}
        for name, draws in posterior.draws.items():
            assert found[name].dims == ("chain", "draw") and found[name].attrs["units"] == standin.UNITS[name]
            np.testing.assert_array_equal(found[name].values, draws)  # float64 in, float64 out
        assert found["chain"].values.tolist() == [0, 1, 2, 3]
    with h5netcdf.File(path) as file:
        assert list(file.groups) == ["posterior"]


def test_the_same_draws_give_the_same_bytes(tmp_path):
    for name in ("a.nc", "b.nc"):
        outputs.write_draws(standin.posterior(), tmp_path / name)
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


@pytest.fixture
def older(tmp_path):
    """A folder with an older set and a file of the user's own."""
    folder = tmp_path / "identified"
    folder.mkdir()
    for name in (
        outputs.FIT,
        outputs.DRAWS,
        outputs.REPORT,
        outputs.CONTROLLER,
        outputs.HEADER,
        outputs.SOURCE,
        outputs.PLATE,
        outputs.KEPT,
        outputs.ZOOMABLE,
        "notes.txt",
    ):
        (folder / name).write_text(f"older {name}")
    return folder


def stage(folder, *names):
    with outputs.staging(folder) as fresh:
        for name in names:
            (fresh / name).write_text(f"newer {name}")
        outputs.place(fresh, folder)


def read(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_a_set_replaces_the_older_one_and_stale_controllers_go(older):
    stage(older, outputs.FIT, outputs.DRAWS, outputs.REPORT)
    names = (outputs.FIT, outputs.DRAWS, outputs.REPORT)
    assert read(older) == {name: f"newer {name}" for name in names} | {"notes.txt": "older notes.txt"}
    assert [path.name for path in older.parent.iterdir()] == ["identified"]


def test_fit_json_stands_beside_the_files_of_its_own_run_alone(older, monkeypatch):
    """Whatever the moment at which the process is killed: it goes out first and comes in last, controllers
    next to it."""
    seen = []

    def replace(source, target):
        rename(source, target)
        seen.append(
            {path.name: path.read_text().split()[0] for path in older.iterdir() if path.name in outputs.FILES}
        )

    rename = os.replace
    monkeypatch.setattr(os, "replace", replace)
    stage(older, *outputs.FILES)
    assert len(seen) == 2 * len(outputs.FILES) and not any(outputs.FIT in files for files in seen[:-1])
    assert set(seen[-1].values()) == {"newer"} and set(seen[-1]) == set(outputs.FILES)
    names = (outputs.CONTROLLER, outputs.HEADER, outputs.SOURCE, outputs.PLATE)
    controllers = [{files[name] for name in names if name in files} for files in seen]
    assert controllers[:4] == 4 * [{"older"}] and not any("older" in found for found in controllers[4:])
    assert not any(controllers[4:10])  # and the newer ones come when the report and the draws are there


@pytest.mark.parametrize("failing", range(12))
def test_an_older_set_stands_when_a_rename_fails(older, monkeypatch, failing):
    """No space for a name, a file that another program holds: each of the nine that go out and of the three
    that come in."""
    before, calls = read(older), []

    def replace(source, target):
        calls.append(source)
        if len(calls) == failing + 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        rename(source, target)

    rename = os.replace
    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(OSError, match="No space left"):
        stage(older, outputs.FIT, outputs.DRAWS, outputs.REPORT)
    assert len(calls) == 2 * failing + 1 and read(older) == before


@pytest.mark.parametrize("name", outputs.FILES)
def test_a_directory_of_the_users_is_not_taken_for_a_file(older, name):
    (older / name).unlink()
    (older / name).mkdir()
    (older / name / "mine").write_text("mine")
    with pytest.raises(IsADirectoryError):
        stage(older, *outputs.FILES)
    assert (older / name / "mine").read_text() == "mine"


def test_draws_on_a_full_disk_are_an_error_of_the_disk(tmp_path):
    """The library of the format answers otherwise, and then cannot close its file."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            outputs.write_draws(standin.posterior(), tmp_path / "posterior.nc")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.skipif(os.name != "posix", reason="processes are forked")
@pytest.mark.parametrize("writers", [1, 2])
def test_killed_at_any_moment_it_leaves_no_mixture(writers):
    """A short version of the study benchmarks/kill_writing.py."""
    study = Path(__file__).parents[1] / "benchmarks" / "kill_writing.py"
    command = [sys.executable, str(study), "--kills", "25", "--writers", str(writers), "--print"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "| 25 |" in done.stdout


def test_an_interrupt_while_files_move_does_not_leave_a_mixture(older, monkeypatch):
    def replace(source, target):
        rename(source, target)
        os.kill(os.getpid(), signal.SIGINT)

    rename, before = os.replace, signal.getsignal(signal.SIGINT)  # a job in the background ignores interrupts
    monkeypatch.setattr(os, "replace", replace)
    stage(
        older,
        outputs.FIT,
        outputs.REPORT,
        outputs.DRAWS,
        outputs.CONTROLLER,
        outputs.HEADER,
        outputs.SOURCE,
        outputs.PLATE,
    )
    assert all(text.startswith("newer") for name, text in read(older).items() if name != "notes.txt")
    assert signal.getsignal(signal.SIGINT) is before


def test_the_fresh_folder_is_removed_when_writing_fails(older):
    before = read(older)
    with pytest.raises(RuntimeError), outputs.staging(older) as fresh:
        (fresh / outputs.FIT).write_text("half")
        raise RuntimeError
    assert read(older) == before


def test_a_new_folder_is_made_only_when_files_move_in(tmp_path):
    folder = tmp_path / "a" / "b"
    outputs.check_writable(folder)
    assert not list(tmp_path.iterdir())
    stage(folder, outputs.FIT)
    assert read(folder) == {outputs.FIT: f"newer {outputs.FIT}"}


def test_folders_that_cannot_be_written_are_found_early(tmp_path, older):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError):
        outputs.check_writable(tmp_path / "file")
    with pytest.raises(OSError):
        outputs.check_writable(tmp_path / "file" / "below")
    (older / outputs.CONTROLLER).unlink()
    (older / outputs.CONTROLLER).mkdir()
    with pytest.raises(OSError, match="directory"):
        outputs.check_writable(older)


def test_digests_are_those_of_the_files(tmp_path):
    contents = {"a": b"one", "b": b"two"}
    for name, content in reversed(contents.items()):
        (tmp_path / name).write_bytes(content)
    assert list(outputs.digests(tmp_path).items()) == [
        (n, hashlib.sha256(c).hexdigest()) for n, c in contents.items()
    ]


def test_an_unsuccessful_result_is_its_sentence():
    assert (
        outputs.document(standin.posterior(result=Result.misfit), None, [])["result"] == Result.misfit.value
    )
