"""Files that are written whole or not at all."""

import resource
import subprocess
import sys

import pytest

from sysid.whole import in_place_of

FULL = """
import resource, sys
import sysid, controller
fit = sysid.fit(sysid.read_logs(["data/synthetic/step_100V_24C.csv", "data/synthetic/sweep_24C.csv"]))
posterior = sysid.sample(fit, accuracy="quick")
loop = controller.design(posterior)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))  # as a disk that is full
for work, path in (
    (lambda path: controller.export_c(loop, path), "dq_pi.h"),
    (lambda path: posterior.report(path), "report.html"),
    (lambda path: sysid.write_log(fit.logs[0].log, path), "log.csv"),
):
    try:
        work(f"{sys.argv[1]}/{path}")
    except OSError as error:
        print(path, type(error).__name__)
"""


def test_what_cannot_be_written_leaves_the_older_files_as_they_were(tmp_path):
    """A header of 4096 bytes stood beside the older source: no set that compiles, on a bench."""
    older = {
        name: f"older {name}" for name in ("dq_pi.h", "dq_pi.c", "dq_pi_plate.h", "report.html", "log.csv")
    }
    for name, text in older.items():
        (tmp_path / name).write_text(text)
    done = subprocess.run([sys.executable, "-c", FULL, str(tmp_path)], capture_output=True, text=True)
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["dq_pi.h", "report.html", "log.csv"], (
        done
    )
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == older
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def test_files_take_the_place_of_others_together(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    first.write_text("older")
    with pytest.raises(ZeroDivisionError), in_place_of(first, second) as fresh:
        fresh[0].write_text("new")
        1 / 0  # noqa: B018
    assert first.read_text() == "older" and not second.exists()
    with in_place_of(first, second) as fresh:
        for path in fresh:
            path.write_text("new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "new", "b": "new"}


def test_what_may_not_be_written_is_refused_before_anything_is(tmp_path):
    (tmp_path / "a").write_text("older")
    (tmp_path / "a").chmod(0o600)
    (tmp_path / "b").mkdir()
    with pytest.raises(IsADirectoryError, match="b"), in_place_of(tmp_path / "a", tmp_path / "b"):
        raise AssertionError
    with pytest.raises(FileNotFoundError, match="nowhere"), in_place_of(tmp_path / "nowhere" / "c"):
        raise AssertionError
    with in_place_of(tmp_path / "a") as (fresh,):
        fresh.write_text("new")
    assert (tmp_path / "a").read_text() == "new" and (tmp_path / "a").stat().st_mode & 0o777 == 0o600


def test_a_link_stays_one_and_what_is_no_file_is_written_as_it_is(tmp_path):
    (link := tmp_path / "link").symlink_to(tmp_path / "file")
    with in_place_of(link) as (fresh,):
        fresh.write_text("new")
    assert link.is_symlink() and (tmp_path / "file").read_text() == "new"
    with in_place_of("/dev/null") as (fresh,):
        fresh.write_text("gone")
