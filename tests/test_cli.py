"""The command as its users run it: exit codes, what is printed where, and what becomes of files that are
already there."""

import contextlib
import io
import json
import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace

import pytest
from conftest import Bench, study

from sysid import __version__
from sysid.command import cli
from sysid.command.arguments import parser
from sysid.effects.registry import ADOPTED
from sysid.logs.written import write_log

SYNTHETIC = Path(__file__).parents[1] / "data" / "synthetic"
LOGS = (SYNTHETIC / "sweep_24C.csv", SYNTHETIC / "step_100V_24C.csv")
ALL = {
    "fit.json",
    "fit.npz",
    "posterior.nc",
    "report.html",
    "controller.json",
    "dq_pi.h",
    "dq_pi.c",
    "dq_pi_plate.h",
}
Z = 4.5  # standard deviations of Monte-Carlo error
CONTROLLER = {"controller.json", "dq_pi.h", "dq_pi.c", "dq_pi_plate.h"}


def identify(*arguments, cwd):
    """Run the command; its exit code, its two outputs, and the bytes of `identified` afterwards."""
    command = [sys.executable, "-m", "sysid", *map(str, arguments)]
    # A report must not depend on where it is read; the width of this terminal is not the reader's.
    environment = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "FORCE_COLOR")}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, encoding="utf-8", timeout=600
    )
    return SimpleNamespace(
        code=done.returncode, out=done.stdout, err=done.stderr, files=files(Path(cwd) / "identified")
    )


def here(*arguments, cwd):
    """The same in this process, where no start of another is tested."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = cli.main([*map(str, arguments)])
        except SystemExit as end:  # of the parser
            code = end.code
    return SimpleNamespace(
        code=code, out=out.getvalue(), err=err.getvalue(), files=files(Path(cwd) / "identified")
    )


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()} if folder.exists() else {}


def without_cost(content):
    """What is the same from run to run."""
    return {key: value for key, value in json.loads(content).items() if key not in ("cost", "created")}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with a result of the user's own making beside the files of the command."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "identified").mkdir()
    (folder / "identified" / "notes.txt").write_text("mine")
    return folder


@pytest.fixture(scope="module")
def first(bench):
    return identify(*LOGS, cwd=bench)


@pytest.fixture(scope="module")
def second(bench, first):
    """The same once more, as a script asks for it, over the files of the first."""
    return identify("--json", *LOGS, cwd=bench)


@pytest.fixture(scope="module")
def quick(bench, tmp_path_factory, second):
    older = ("--compare", bench / "identified")
    return here("--json", "--accuracy", "quick", *older, *LOGS, cwd=tmp_path_factory.mktemp("quick"))


@pytest.fixture(scope="module")
def refused(bench, second):
    """Answers of the command to unusable input, over the files of the second run."""
    texts = {"misspelt": "time_s,volage_V,wd_um,wq_um\n0,1,0,0\n1,1,1,0\n", "strange": "a,b\n1,2\n3,4\n"}
    for name, text in texts.items():
        (bench / f"{name}.csv").write_text(text)
    (bench / "file").write_text("in the way")
    cases = {
        "misspelt": ("misspelt.csv",),
        "strange": ("strange.csv",),
        "absent": ("absent.csv",),
        "pattern": ("absent*.csv",),
        "option": ("--effects", "drifts", *LOGS),
        "no logs": (),
        "seed": ("--seed", "-1", *LOGS),
        "budget": ("--budget=-1", *LOGS),
        "both": ("--budget", "9", "--accuracy", "quick", *LOGS),
        "temperature": ("--reference-temperature", "nan", *LOGS),
        "compare": ("--compare", LOGS[0], *LOGS),
        "mapping": ("--columns", "absent.toml", *LOGS),
        "unwritable": ("-o", "file", *LOGS),
        "below a file": ("-o", "file/below", *LOGS),
    }
    starts = {"strange", "no logs"}  # a command of its own: it says by which name it was called
    return {
        name: (identify if name in starts else here)(*arguments, cwd=bench)
        for name, arguments in cases.items()
    }


@pytest.fixture(scope="module")
def failed(bench, refused):
    """A sweep and a step that no one plate explains, over the files of the second run: the step's clock runs
    at half speed."""
    head, *rows = (line for line in LOGS[1].read_text().splitlines() if not line.startswith("#"))
    slow = [f"{2 * float(time)!r},{rest}" for time, _, rest in (row.partition(",") for row in rows)]
    notes = "# temperature_degC: 24\n# frequency_Hz: 32290\n# sampling: instant\n"
    (bench / "slow.csv").write_text(notes + "\n".join([head, *slow]))
    # none of the effects is in the logs, and to search for all of them takes seconds
    without = "--effects=" + ",".join(f"-{name}" for name in ADOPTED)
    return here(without, LOGS[0], "slow.csv", cwd=bench)


@pytest.fixture(scope="module")
def undriven(bench, failed):
    """A sweep without its drive."""
    lines = [line.split(",") for line in LOGS[0].read_text().splitlines() if not line.startswith("#")]
    (bench / "undriven.csv").write_text("\n".join(f"{f},{wd},{wq}" for f, _, wd, wq in lines))
    (bench / "identified" / "dq_pi.h").write_text("stale")
    return here("undriven.csv", cwd=bench)


@pytest.mark.always
def test_success_writes_the_whole_set_and_keeps_the_users_own_file(first):
    assert first.code == 0, first.err
    assert set(first.files) == ALL | {"notes.txt"} and first.files["notes.txt"] == b"mine"
    content = json.loads(first.files["fit.json"])
    assert content["result"] == "successful" and content["reference_temperature_degC"] == 24.0
    assert content["files"] == {
        name: sha256(first.files[name]).hexdigest() for name in sorted(ALL - {"fit.json"})
    }
    assert json.loads(first.files["controller.json"]) == content["controller"]
    cost = content["cost"]
    assert [row["stage"] for row in cost["stages"]] == [
        "read",
        "load",
        "fit",
        "sample",
        "design",
        "compare",
        "report",
    ]
    assert (
        0.9 * cost["total_s"] < sum(row["seconds"] for row in cost["stages"]) <= cost["total_s"]
    )  # but for what is between
    assert cost["next"]["accuracy"] == "exact" and "--accuracy exact would take" in cost["sentence"]


@pytest.mark.study
def test_quick_is_the_standard_within_the_error_that_it_states(first, quick):
    assert quick.code == 0, quick.err
    content, standard = json.loads(quick.out), json.loads(first.files["fit.json"])
    how = content["uncertainty"]
    assert (how["accuracy"], standard["uncertainty"]["accuracy"]) == ("quick", "standard")
    assert how["rungs"] == standard["uncertainty"]["rungs"][:1]  # the second rung stands on the first
    for name in ("G", "tau", "f0"):
        for part in ("value", "std"):
            off, chance = (c["uncertainty"]["numerical_error"][name][part] for c in (content, standard))
            # what the check finds is right to its lowest order, and no larger part is left than it finds
            apart = abs(content["parameters"][name][part] - standard["parameters"][name][part])
            assert apart < 2 * off + Z * chance, (name, part)
    assert content["cost"]["twice_as_exact_s"] is None and content["cost"]["next"]["accuracy"] == "standard"


@pytest.mark.study
def test_an_older_fit_of_the_same_logs_shows_no_change(quick):
    change = json.loads(quick.out)["change"]
    assert not change["changed"] and change["sentence"].startswith("no change of the plate is seen")
    assert list(change["parameters"]) == ["G", "tau", "f0"] and "share logs" in change["notes"][0]
    assert "Change from an older fit" in quick.files["report.html"].decode()


def test_parameters_are_those_that_the_logs_were_made_from(first):
    parameters = json.loads(first.files["fit.json"])["parameters"]
    # data/synthetic/truth.toml; four standard deviations, one chance in ten thousand
    for name, truth in {"G": 0.02, "tau": 5e-3 / 2.995732273553991, "f0": 32300.0}.items():
        assert abs(parameters[name]["value"] - truth) < 4 * parameters[name]["std"], name
    assert parameters["k_T"]["value"] is None and "one temperature" in parameters["k_T"]["why"]


@pytest.mark.study  # a design for each experiment
def test_advice_on_the_margin_names_an_experiment(tmp_path):
    write_log(Bench().transient(noise=0.1), tmp_path / "noisy.csv")
    done = identify("--json", "--accuracy", "quick", "--advise", "margin", "noisy.csv", cwd=tmp_path)
    best = json.loads(done.out)["advice"][0]
    assert (
        done.code == 0
        and best["promise"] == "margin"
        and best["before"]
        < best["after"]
        <= 1.01 * best["exactly_known"]  # as much as the worst of so few is known to
    )
    assert best["sentence"].startswith(f"a {best['experiment']['kind']} ")


@pytest.mark.study  # two designs
def test_where_no_experiment_helps_the_reason_is_told(tmp_path):
    step = SYNTHETIC / "coloured_step.csv"
    done = identify("--accuracy", "quick", "--advise", "margin", step, cwd=tmp_path)
    told = json.loads(done.files["fit.json"])
    assert done.code == 0 and told["advice"] == []
    assert told["no_advice"].startswith("no step or sweep betters the disk margin promised by as much as 1 %")
    assert told["no_advice"] in " ".join(done.out.split())


def test_the_screen_shows_logs_parameters_gains_and_files(first):
    for words in (
        "sweep_24C.csv",
        "steady",
        "transient",
        "tau",
        "±",
        "not determined",
        "record a sweep",
        "Kp",
        "fit.json",
    ):
        assert words in " ".join(first.out.split()), words
    lines = first.out.splitlines()
    assert lines[0] == "successful: G, tau and f0 of plate A7 are determined from 2 logs; k_T is not"
    cost = [line for line in lines if line.startswith("cost ")]
    assert len(cost) == 1 and "std; --accuracy exact would take " in cost[0] and " s more" in cost[0]
    assert "\x1b" not in first.out and len(lines) <= 45 and max(map(len, lines)) <= 80


def test_json_prints_fit_json_and_nothing_else(second):
    assert second.code == 0, second.err
    assert second.out.encode() == second.files["fit.json"]


def test_the_same_logs_give_the_same_bytes(first, second):
    assert set(first.files) == set(second.files)
    for name in set(first.files) - {"fit.json"}:
        assert first.files[name] == second.files[name], name
    assert without_cost(first.files["fit.json"]) == without_cost(second.files["fit.json"])


def test_save_writes_what_the_command_writes(second, tmp_path):
    import controller
    import sysid

    fit = sysid.fit(sysid.read_logs(LOGS))
    fit.save(tmp_path / "saved", controller.design(fit.posterior))
    saved = files(tmp_path / "saved")
    assert set(saved) == ALL
    assert {name for name in ALL - {"fit.json"} if saved[name] != second.files[name]} == set()
    assert without_cost(saved["fit.json"]) == without_cost(second.files["fit.json"])


def test_fit_json_keeps_its_schema(second, failed, undriven):
    import jsonschema

    from sysid.report import html

    schema = json.loads((Path(html.__file__).parent / "fit.schema.json").read_text(encoding="utf-8"))
    for answer in (second, failed, undriven):
        jsonschema.Draft202012Validator(schema).validate(json.loads(answer.files["fit.json"]))


def test_what_the_command_wrote_is_loaded(bench, undriven):
    import sysid

    fit = sysid.load(bench / "identified")
    written = json.loads(undriven.files["fit.json"])["parameters"]
    assert {n: p.value for n, p in fit.posterior.summary().items()} == {
        n: p["value"] for n, p in written.items()
    }


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("misspelt", ("misspelt.csv", "volage_V", "voltage_V")),
        ("strange", ("strange.csv", "expected", "identify --columns map.toml LOGS", "[columns]")),
        ("absent", ("absent.csv", "no such file")),
        ("pattern", ("absent*.csv", "pattern")),
        ("option", ("usage:", "--effects")),
        ("no logs", ("usage:", "LOGS")),
        ("budget", ("--budget", "-1")),
        ("both", ("--budget", "not allowed with", "--accuracy")),
        ("seed", ("--seed", "expected a whole number from 0 to")),
        ("temperature", ("--reference-temperature", "nan")),
        ("compare", ("--compare", "sweep_24C.csv", "found no JSON")),
        ("mapping", ("absent.toml",)),
        ("unwritable", ("file", "cannot be written", "file is a file, expected a directory")),
        ("below a file", ("below", "cannot be written", "file is a file, expected a directory")),
    ],
)
def test_unusable_input_is_named_and_changes_nothing(refused, second, case, words):
    answer = refused[case]
    assert answer.code == 2 and answer.out == ""
    assert "Traceback" not in answer.err
    for word in words:
        assert word in answer.err, answer.err
    assert answer.files == second.files


def test_failure_says_why_and_removes_the_stale_controller(failed):
    assert failed.code == 1, failed.err
    assert set(failed.files) == ALL - CONTROLLER | {"notes.txt"}
    content = json.loads(failed.files["fit.json"])
    assert content["result"] == "the model does not describe the logs" and content["controller"] is None
    assert set(content["files"]) == {"posterior.nc", "report.html", "fit.npz"}
    assert content["result"] in failed.out and "no controller" in failed.out
    assert "warning: " in failed.err and ".csv" in failed.err and content["warnings"]


def test_without_a_drive_there_is_no_gain_and_no_controller(undriven):
    assert undriven.code == 0, undriven.err
    assert set(undriven.files) == ALL - CONTROLLER | {"notes.txt"}
    parameters = json.loads(undriven.files["fit.json"])["parameters"]
    assert (
        parameters["tau"]["determined"]
        and parameters["G"]["value"] is None
        and "drive" in parameters["G"]["why"]
    )
    assert "no controller: G is not determined" in undriven.err


def test_nothing_temporary_is_left(bench, undriven):
    assert not [path for path in bench.rglob("*") if path.name.startswith(".")]


def test_help_and_version_wait_for_no_library():
    """Importing numpy alone takes a third of the 0.3 s that help may take; the compiler takes seconds."""
    program = "import sys\nfrom sysid.command.cli import main\n"
    program += "try: main(sys.argv[1:])\nexcept SystemExit: print(sorted(sys.modules))"
    for option, words in (("--help", "--reference-temperature"), ("--version", __version__)):
        out = subprocess.run(
            [sys.executable, "-c", program, option], capture_output=True, text=True, check=True
        ).stdout
        assert words in out
        assert not {"'numpy'", "'jax'", "'pandas'", "'matplotlib'", "'emcee'", "'rich'"} & set(
            out.strip("[]\n").split(", ")
        )


def test_a_rig_file_that_is_wrong_is_refused(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text("latency_V = 1\n")
    folder = tmp_path / "identified"
    assert cli.main([str(LOGS[0]), "-o", str(folder), "--rig", str(tmp_path / "rig.toml")]) == 2
    assert "latency_V: found \"the unit 'V'\", expected s" in capsys.readouterr().err and not folder.exists()


def test_an_interrupt_exits_130_and_leaves_files_alone(monkeypatch, tmp_path, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("sysid.logs.read.read_logs", interrupted)
    assert cli.main([str(LOGS[0]), "-o", str(tmp_path / "identified")]) == 130
    assert not list(tmp_path.iterdir()) and "interrupted" in capsys.readouterr().err


def test_a_defect_is_no_result(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("sysid.logs.read.read_logs", lambda *_: 1 / 0)
    assert cli.main([str(LOGS[0]), "-o", str(tmp_path / "identified")]) not in (0, 1, 2)
    assert "ZeroDivisionError" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "idle"),
    [
        (("--check", "a.csv", "--rig", "absent.toml"), "--rig"),
        (("--check", "a.csv", "--advise", "tau", "--seed", "0"), "--advise, --seed"),
        (("--check", "a.csv", "--effects=none", "--prior=k_T=-8+-1"), "--effects, --prior"),
        (("--check", "a.csv", "--reference-temperature", "24"), "--reference-temperature"),
        (("--check", "a.csv", "--cost-curve"), "--cost-curve"),
        (("--check", "a.csv", "--budget", "9"), "--budget"),
        (("a.csv", "--cost-curve", "--rig", "absent.toml", "--advise", "tau"), "--advise, --rig"),
    ],
)
def test_an_option_that_has_nothing_to_do_is_refused(arguments, idle, capsys):
    with pytest.raises(SystemExit) as refused:
        cli.main(arguments)
    assert refused.value.code == 2
    assert f"found {idle} beside --" in capsys.readouterr().err


def test_figures_to_zoom_into_need_plotly(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(cli, "find_spec", lambda name: None)
    assert cli.main(["-o", str(tmp_path / "out"), "--zoomable", *map(str, LOGS)]) == 2
    assert "pip install 'sysid[zoom]'" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "given",
    ["--seed=x", "--seed=-1", "--budget=x", "--reference-temperature=x", "--reference-temperature=-300"],
)
def test_a_number_that_is_not_understood_is_refused_with_what_was_expected(given, capsys):
    with pytest.raises(SystemExit) as refused:
        parser().parse_args([given, "log.csv"])
    option, _, value = given.partition("=")
    said = capsys.readouterr().err
    assert refused.value.code == 2
    assert f"argument {option}: found {value}, expected" in said


@pytest.mark.study
@pytest.mark.parametrize("form", [[], study(["--json"])], ids=str)
def test_a_reader_that_leaves_changes_no_exit_code(tmp_path, form):
    """As `identify ... | head -1` does: what the command found and wrote is as it would be."""
    command = [sys.executable, "-m", "sysid", "--accuracy", "quick", *form, *map(str, LOGS)]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.close()
        said = running.stderr.read()
    assert running.returncode == 0 and b"Traceback" not in said and b"Exception" not in said, said
    assert set(files(tmp_path / "identified")) == ALL


def test_names_cannot_steer_the_terminal(tmp_path):
    answer = identify("a\x1b[2J.csv", cwd=tmp_path)
    assert answer.code == 2 and "\x1b" not in answer.err and "a\\u001b[2J.csv" in answer.err


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("none", ()),
        ("late,rotation", ("rotation", "late")),
        ("-late", ("rotation", "background", "offset", "start", "thermometer", *ADOPTED)),
        ("-start, -offset, -thermometer", ("rotation", "background", "late", *ADOPTED)),
        ("+drift", ("rotation", "background", "offset", "start", "late", "thermometer", *ADOPTED, "drift")),
        (
            "-late,+gain,+lag",
            ("rotation", "background", "offset", "start", "thermometer", *ADOPTED, "lag", "gain"),
        ),
        (
            "-second_mode,-late",
            (
                "rotation",
                "background",
                "offset",
                "start",
                "thermometer",
                *(e for e in ADOPTED if e != "second_mode"),
            ),
        ),
        ("rotation,drift", ("rotation", "drift")),
    ],
)
def test_effects_are_forced_in_or_out(text, kept):
    assert parser().parse_args([f"--effects={text}", "log.csv"]).effects == kept


@pytest.mark.parametrize(
    "text", ["lateness", "-rotation,late", "+drift,late", "", "none,late", "--late", "+-late", ","]
)
def test_effects_that_are_not_understood_are_refused(text, capsys):
    with pytest.raises(SystemExit) as refused:
        parser().parse_args([f"--effects={text}", "log.csv"])
    assert refused.value.code == 2
    assert "expected" in capsys.readouterr().err
