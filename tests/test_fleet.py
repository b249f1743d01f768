"""Many plates: found, fitted in processes that may be killed, in one table; those that are not like the
others."""

import errno
import multiprocessing
import os
import re
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import reference
from conftest import study

import sysid
from sysid.command.fleet import main
from sysid.fleet.groups import grouped
from sysid.fleet.settings import Settings


def plant(seed):
    """One of a lot that scatters by 10 % and 20 Hz."""
    a, b, c = np.random.default_rng([7, seed]).standard_normal(3)
    return reference.Plant(0.02 * np.exp(0.1 * a), 1.67e-3 * np.exp(0.1 * b), 32300 + 20 * c, -10.0)


def step(seed, noise=0.02):
    """240 rows of a step by 100 V."""
    time, volts = 1e-4 * np.arange(240), np.repeat([0.0, 100.0], [20, 220])
    rest = np.full(240, 32290.0), np.full(240, 24.0)
    clean = np.exp(0.3j) * reference.ringing(plant(seed), time, volts, *rest) + 0.004 - 0.003j
    response = clean + reference.noise(240, noise, seed, time)
    inputs = {"time": time, "drive": volts, "frequency": rest[0], "temperature": rest[1]}
    return sysid.Log(f"step {seed}", response, sampling="instant", metadata={"plate": f"P{seed}"}, **inputs)


def sweep(seed, noise=0.02):
    """101 settled points over +-500 Hz."""
    frequency = np.linspace(31800, 32800, 101)
    response = reference.steady(plant(seed), 100.0, frequency, 24.0) + reference.noise(101, noise, seed + 1)
    inputs = {"drive": np.full(101, 100.0), "frequency": frequency, "temperature": np.full(101, 24.0)}
    return sysid.Log(f"sweep {seed}", response, metadata={"plate": f"P{seed}"}, **inputs)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Five plates with a step and a sweep each, and one file that is no log."""
    where = tmp_path_factory.mktemp("logs")
    for seed in range(5):
        sysid.write_log(step(seed), where / f"P{seed}_step.csv")
        sysid.write_log(sweep(seed), where / f"P{seed}_sweep.csv")
    (where / "P9_step.csv").write_text("# plate: P9\ntime_s,voltage_V,wd_um,wq_um\n0,1,2,3\n1,x,2,3\n")
    return where


@pytest.fixture(scope="module")
def made(folder, tmp_path_factory):
    """What the command makes of that folder, and its exit code."""
    where = tmp_path_factory.mktemp("results")
    return main([str(folder), "-o", str(where), "--jobs", "2"]), where


@pytest.mark.always
def test_every_plate_is_a_row_near_the_truth(made):
    code, where = made
    table = pd.read_csv(where / "fleet.csv").set_index("plate")
    assert code == 0
    assert list(table.index) == ["P0", "P1", "P2", "P3", "P4", "P9"]
    for seed in range(5):
        row, truth = table.loc[f"P{seed}"], plant(seed)
        assert row["result"] == "successful"
        for name in ("G", "tau", "f0"):
            assert abs(row[name] - getattr(truth, name)) < 4 * row[f"{name}_std"]
            assert row[f"{name}_ci95_low"] < row[name] < row[f"{name}_ci95_high"]
        assert not row["k_T_determined"] and "one temperature" in row["k_T_why"]


def test_a_bad_file_is_a_row_with_the_reader_s_sentence(made, folder):
    row = pd.read_csv(made[1] / "fleet.csv").set_index("plate").loc["P9"]
    with pytest.raises(sysid.LogError) as refused:
        sysid.read_logs(folder / "P9_step.csv")
    assert row["result"] == "the logs cannot be read"
    assert row["error"] == str(refused.value)


def test_the_parquet_table_is_the_csv(made):
    frame, text = pd.read_parquet(made[1] / "fleet.parquet"), pd.read_csv(made[1] / "fleet.csv")
    assert list(frame.columns) == list(text.columns)
    np.testing.assert_array_equal(frame["tau"], text["tau"])
    assert [len(logs) for logs in frame["logs"]] == [2, 2, 2, 2, 2, 1]


def test_what_is_done_is_not_done_again(made, folder, monkeypatch):
    before = pd.read_csv(made[1] / "fleet.csv")
    monkeypatch.setattr("sysid.fleet.run.Processes.rows", None)  # nothing may be left to fit
    monkeypatch.setattr("sysid.fleet.run.Here.rows", None)
    assert main([str(folder), "-o", str(made[1]), "--jobs", "2"]) == 0
    pd.testing.assert_frame_equal(pd.read_csv(made[1] / "fleet.csv"), before)


def test_numbers_by_the_lot_stand_beside_and_need_no_fit(made, folder, tmp_path, monkeypatch):
    import shutil

    where = tmp_path / "results"
    shutil.copytree(made[1], where)
    monkeypatch.setattr("sysid.fleet.run.Processes.rows", None)
    assert main([str(folder), "-o", str(where), "--jobs", "2", "--shrink"]) == 0
    before, after = (pd.read_parquet(place / "fleet.parquet") for place in (made[1], where))
    pd.testing.assert_frame_equal(after[before.columns], before)
    added = after.drop(columns=before.columns)
    assert {"G_pooled", "G_pooled_std", "f0_pooled"} < {*added} and added.isna().all(axis=None)  # of five


@pytest.mark.study
def test_a_log_that_changed_is_fitted_again(made, folder, tmp_path):
    import shutil

    logs, where = tmp_path / "logs", tmp_path / "results"
    shutil.copytree(folder, logs)
    shutil.copytree(made[1], where)
    sysid.write_log(step(33), logs / "P1_step.csv")
    text = (logs / "P1_step.csv").read_text().replace("P33", "P1")
    (logs / "P1_step.csv").write_text(text)
    (where / "parts" / "broken.jsonl").write_text('{"plate": "P')  # a part that a disk has lost half of
    table = sysid.fit_fleet(logs, folder=where, jobs=0)
    before = pd.read_csv(made[1] / "fleet.csv")
    changed = table["seconds"].to_numpy() != before["seconds"].to_numpy()
    assert list(table["plate"][changed]) == ["P1"]


def test_a_run_that_grows_is_weighed_as_one(tmp_path):
    """A row is of a run of up to so many plates: one that comes to them within is fitted beside what is done;
    beyond, all are weighed anew, unless each is fitted by itself."""
    logs = {f"P{seed}": [step(seed)] for seed in range(5)}
    some = lambda count: {name: logs[name] for name in [*logs][:count]}  # noqa: E731

    def fitted(count, lane):
        found = []
        sysid.fit_fleet(
            some(count), folder=tmp_path / str(lane), jobs=0, lane=lane, meanwhile=lambda *c: found.append(c)
        )
        return len(found)

    assert [fitted(count, True) for count in (3, 4, 4, 5)] == [3, 1, 0, 5]
    assert [fitted(count, False) for count in (3, 4, 5)] == [3, 1, 1]
    for count, of in ((1, 1), (2, 2), (3, 4), (1000, 1024), (1024, 1024), (1025, 2048)):
        assert Settings().of_run(count).plates == of


def test_the_table_is_what_fit_and_sample_say():
    logs = [step(1), sweep(1)]
    told = sysid.sample(sysid.fit(logs), seed=0, accuracy="quick").summary()["tau"]
    row = sysid.fit_fleet({"one": logs}, jobs=0, lane=False).iloc[0]
    found = (row["plate"], row["tau"], row["tau_std"], row["tau_unit"])
    assert found == ("one", told.value, told.std, "s")


@pytest.mark.study
@pytest.mark.skipif(sys.platform != "linux", reason="only there a file's name may be any bytes")
def test_a_file_s_name_may_be_no_text(tmp_path):
    logs, where = tmp_path / "logs", tmp_path / "results"
    logs.mkdir()
    for seed, name in ((1, b"P1_step.csv"), (2, b"P\xff_step.csv")):
        sysid.write_log(step(seed), tmp_path / "log.csv")
        os.rename(tmp_path / "log.csv", os.path.join(os.fsencode(logs), name))
    table = sysid.fit_fleet([logs], by="(P.)_", jobs=2, folder=where, full=True)
    assert list(table["plate"]) == ["P1", "P\udcff"] and {*table["result"]} == {"successful"}
    assert list(pd.read_csv(where / "fleet.csv")["plate"]) == ["P1", "P\\udcff"]
    assert list(pd.read_parquet(where / "fleet.parquet")["plate"]) == ["P1", "P\\udcff"]
    assert sorted(os.listdir(where / "plates")) == ["P%FF", "P1"]
    assert "P%25FF/report.html" in (where / "fleet.html").read_text(encoding="utf-8")


class Deadly(dict):
    """Metadata that kill the process of a pool that reads them, or what `victim` gives, as often as there are
    files to take away."""

    def items(self):
        if multiprocessing.parent_process() is not None:
            for path in sorted(self["lives"].glob("*")):
                path.unlink()
                os.kill(self.get("victim", os.getpid)(), signal.SIGKILL)
        return super().items()


@pytest.mark.parametrize("deaths", [study(1), study(2), 3])
def test_a_killed_process_costs_nobody_else_a_row(tmp_path, deaths):
    from dataclasses import replace

    for k in range(deaths):
        (tmp_path / str(k)).touch()
    logs = {f"P{seed}": [step(seed)] for seed in range(4)}
    logs["P2"] = [replace(step(2), metadata=Deadly(lives=tmp_path))]
    done = []
    table = sysid.fit_fleet(logs, jobs=2, meanwhile=lambda *counts: done.append(counts))
    ended = {name: "successful" for name in logs} | (
        {"P2": "the fit ended its process twice"} if deaths == 3 else {}
    )
    assert dict(zip(table["plate"], table["result"], strict=True)) == ended
    assert sorted(done)[-1] == (4, 4) and len(set(done)) == len(done)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="only there processes are forks of a server")
def test_a_killed_server_costs_nobody_a_row(tmp_path):
    from dataclasses import replace

    (tmp_path / "0").touch()
    logs = {f"P{seed}": [step(seed)] for seed in range(4)}
    logs["P2"] = [replace(step(2), metadata=Deadly(lives=tmp_path, victim=os.getppid))]
    table = sysid.fit_fleet(logs, jobs=2)
    assert list(table["plate"]) == [*logs] and {*table["result"]} == {"successful"}
    assert not list(tmp_path.iterdir())


def test_a_full_disk_ends_the_run_and_keeps_what_is_done(tmp_path, monkeypatch):
    logs, fitted, sync = {f"P{seed}": [step(seed)] for seed in range(10)}, [], os.fsync

    def full(file):
        if len(fitted) >= 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(file)

    def run():
        fitted.clear()
        told = lambda done, _: fitted.append(done)  # noqa: E731
        return sysid.fit_fleet(logs, jobs=0, folder=tmp_path, meanwhile=told)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        run()
    assert fitted == [1, 2, 3, 4] and len(list((tmp_path / "parts").iterdir())) == 4
    monkeypatch.setattr(os, "fsync", sync)
    assert list(run()["plate"]) == [*logs] and fitted == [5, 6, 7, 8, 9, 10]


def as_table(log, plate, name):
    """The rows of a log in a table of many plates."""
    recorded = {
        "time_s": log.time,
        "voltage_V": log.drive,
        "frequency_Hz": log.frequency,
        "temperature_degC": log.temperature,
        "wd_um": log.response.real,
        "wq_um": log.response.imag,
    }
    known = {name: values for name, values in recorded.items() if values is not None}
    return pd.DataFrame({"plate": plate, "log": name, "sampling": log.sampling} | known)


def test_many_plates_in_one_parquet_file(tmp_path):
    """The rows are those of the logs, to the last bit; a plate without a response, and rows of no plate, are
    rows with a sentence."""
    logs = {f"P{seed}": [step(seed), sweep(seed)] for seed in range(3)}
    weak = step(2)  # at half of the drive that the others have
    logs["P2"][0] = replace(weak, drive=0.5 * weak.drive, response=0.5 * weak.response)
    parts = [as_table(log, plate, k) for plate, own in logs.items() for k, log in enumerate(own)]
    mute, nameless = as_table(step(3), "P3", 0), as_table(step(4), None, 0)
    mute[["wd_um", "wq_um"]] = np.nan
    pd.concat([*parts, mute, nameless]).to_parquet(tmp_path / "all.parquet")
    table = sysid.fit_fleet([tmp_path], jobs=0).set_index("plate")
    own = sysid.fit_fleet(logs, jobs=0).set_index("plate")
    numbers = [f"{name}{more}" for name in ("G", "tau", "f0") for more in ("", "_std")]
    np.testing.assert_array_equal(table.loc[[*logs], numbers], own[numbers])
    assert list(table.index) == [*logs, "P3", str(tmp_path / "all.parquet")]
    assert "response" in table["error"].iloc[3] and "without a plate" in table["error"].iloc[4]


class TestGroups:
    def files(self, where, *names):
        for name in names:
            (where / name).parent.mkdir(exist_ok=True, parents=True)
            (where / name).write_text("x")
        return where

    def named(self, groups):
        return {g.plate: [os.path.basename(path) for path in g.logs] for g in groups}

    def test_by_folder(self, tmp_path):
        self.files(
            tmp_path, "a/one.csv", "a/two.CSV", "b/three.mat", "b/notes.md", ".hidden/x.csv", "top.csv"
        )
        found = self.named(grouped([tmp_path], "folder"))
        assert found == {tmp_path.name: ["top.csv"], "a": ["one.csv", "two.CSV"], "b": ["three.mat"]}

    def test_by_pattern(self, tmp_path):
        self.files(tmp_path, "x_A7_step.csv", "x_A7_sweep.csv", "x_A8_step.csv", "other.csv")
        found = grouped([tmp_path], r"_(A\d+)_")
        names = self.named(found)
        assert names.pop(str(tmp_path / "other.csv")) == ["other.csv"]
        assert "does not fit" in found[-1].refused
        assert names == {"A7": ["x_A7_step.csv", "x_A7_sweep.csv"], "A8": ["x_A8_step.csv"]}

    def test_what_a_pattern_leaves_out_of_another_kind_is_no_plate(self, tmp_path):
        """It was an odd one, as a note beside its logs."""
        self.files(tmp_path, "A7_step.csv", "A8_step.csv", "bad.csv", "ports.txt")
        aside = []
        found = self.named(grouped([tmp_path], r"(A\d+)_", aside=aside))
        assert [*found] == ["A7", "A8", str(tmp_path / "bad.csv")] and aside == [str(tmp_path / "ports.txt")]
        named = grouped([tmp_path / "A7_step.csv", tmp_path / "ports.txt"], r"(A\d+)_", aside=aside)
        assert "does not fit" in named[1].refused and len(aside) == 1

    def test_a_folder_that_is_not_there_is_refused(self, tmp_path):
        """It was one odd plate."""
        with pytest.raises(sysid.LogError, match="nothing_here: found no such file or folder"):
            grouped([tmp_path / "nothing_here"], "plate")

    def test_results_beside_the_logs_are_none(self, tmp_path):
        self.files(tmp_path, "a.csv", "fleet/fleet.csv", "fleet/parts/b.csv")
        assert self.named(grouped([tmp_path], "(.)", beside=tmp_path / "fleet")) == {"a": ["a.csv"]}

    def test_logs_by_the_plate_they_state(self):
        groups = grouped([step(1), step(2), sweep(1)], "plate")
        assert {g.plate: [log.name for log in g.logs] for g in groups} == {
            "P1": ["step 1", "sweep 1"],
            "P2": ["step 2"],
        }

    @pytest.mark.parametrize("by", ["(", "a(b)(c)", "abc"])
    def test_patterns_that_are_none(self, by, tmp_path):
        with pytest.raises(ValueError, match="regular expression with one group"):
            grouped([self.files(tmp_path, "a.csv")], by)

    def test_nothing_says_a_plate(self, tmp_path):
        path = tmp_path / "a.csv"
        path.write_text("time_s,voltage_V,wd_um,wq_um\n0,1,2,3\n1,2,2,3\n")
        with pytest.raises(sysid.LogError, match="--by folder"):
            grouped([path], "plate")

    def test_one_name_twice(self):
        with pytest.raises(sysid.LogError, match="2 groups of the plate 'P1'"):
            grouped([[step(1)], [step(1)]], "plate")


@pytest.mark.parametrize("given", [["--jobs", "0"], ["--by", "("], ["--accuracy", "best"]])
def test_bad_usage_exits_with_2(given, folder, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main([str(folder), *given, "-o", str(tmp_path / "new")])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "found" in said or "invalid choice" in said
    assert not (tmp_path / "new").exists()


def test_no_logs_exit_with_2(tmp_path, capsys):
    assert main([str(tmp_path / "*.csv"), "-o", str(tmp_path / "new")]) == 2
    assert "expected at least one" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "given", [{"nuisances": ["luck"]}, {"priors": {"tau": (1, -1)}}, {"jobs": -1}, {"full": True}]
)
def test_settings_that_are_none(given):
    with pytest.raises(ValueError, match="expected"):
        sysid.fit_fleet([[step(1)]], **given)


@pytest.mark.study
@pytest.mark.filterwarnings("default")
def test_through_a_dask_scheduler(tmp_path):
    distributed = pytest.importorskip("distributed")
    from dataclasses import replace

    for k in range(20):
        (tmp_path / f"{k:02d}").touch()
    logs = {f"P{seed}": [step(seed)] for seed in range(3)}
    here = sysid.fit_fleet(logs, jobs=0)
    deadly = logs | {"P1": [replace(step(1), metadata=Deadly(lives=tmp_path))]}
    settings = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "memory_limit": 0}
    with distributed.LocalCluster(processes=True, **settings) as cluster:
        table = sysid.fit_fleet(logs, scheduler=cluster.scheduler_address)
        hurt = sysid.fit_fleet(deadly, scheduler=cluster.scheduler_address)
    pd.testing.assert_frame_equal(table.drop(columns="seconds"), here.drop(columns="seconds"))
    assert list(hurt["result"]) == ["successful", "the fit ended its process twice", "successful"]


@pytest.mark.study
@pytest.mark.filterwarnings("default")
def test_a_dask_scheduler_that_ends_ends_the_run(tmp_path, monkeypatch):
    """What it has done is kept; and one without workers is waited for only for a while."""
    distributed = pytest.importorskip("distributed")
    from sysid.fleet import engine

    logs = {f"P{seed}": [step(seed)] for seed in range(8)}
    settings = {"threads_per_worker": 1, "dashboard_address": None, "memory_limit": 0}
    with distributed.LocalCluster(n_workers=1, processes=False, **settings) as cluster:
        run = lambda end: sysid.fit_fleet(  # noqa: E731
            logs, folder=tmp_path, scheduler=cluster.scheduler_address, meanwhile=end
        )
        with pytest.raises(engine.EngineError, match="ended; what is done is kept"):
            run(lambda done, _: cluster.close())
    assert list((tmp_path / "parts").iterdir())
    monkeypatch.setattr(engine, "COMES", 1)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, **settings) as cluster,
        pytest.raises(engine.EngineError, match="found no worker"),
    ):
        sysid.fit_fleet(logs, scheduler=cluster.scheduler_address)


def test_the_page_s_example_runs(monkeypatch, capsys):
    root = Path(__file__).parents[1]
    code = re.search(
        r"```python\n(.*?)```", (root / "docs" / "fleet.md").read_text(encoding="utf-8"), re.DOTALL
    )
    monkeypatch.chdir(root)
    exec(code.group(1), {})
    said = capsys.readouterr().out
    assert "A7" in said and said.count("successful") == 2
