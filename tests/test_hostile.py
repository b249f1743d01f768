"""Nobody is let in: text of a log, a mapping or a file's name stays text in all that is printed and
written."""

import io
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import standin
from conftest import study

import controller
from controller.export import texts
from sysid.command import outputs
from sysid.logs.log import LogError
from sysid.logs.read import read_logs
from sysid.logs.written import write_log
from sysid.report import html, screen, text

TEXTS = [
    "</script><script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "*/ #include </etc/passwd> /*",
    '*/\\\n#error "x"',
    "../../outside",
    "/outside",
    "\x1b[2J\x1b]0;title\x07",
    "\x9b31m",
    "a\nresult  successful",
    "a\r\nidentify: all is well",
    "{{ 7 * 7 }}{% raw %}",
    "$\\frac{$",
    "[/bold][link=file:///]",
    "\u202egnp.csv",
    '"\n[columns]\ntime = 3\n#',
    "\x7f\x00",
]


# One for each reader that it is written for, markup, C, terminal, template and TOML: the study takes all.
SEVERAL = [
    text if k in {0, 2, 6, 10, 14} else study(text) for k, text in enumerate(TEXTS)
]  # fmt: skip


@pytest.fixture(params=TEXTS, ids=ascii)
def hostile(request):
    return request.param


def log_file(folder, hostile, header="time_s,voltage_V,w_um"):
    """A log whose name, metadata, header and label hold the text, as far as a file can."""
    name = hostile.replace("/", "|").replace("\x00", "")
    cell = hostile.replace("\n", " ").replace("\r", " ").replace("\x00", "")
    quoted = cell.replace('"', '""')
    head = f'# plate: {cell}\n# {cell}: {cell}\n{header},"{quoted}",log\n'
    path = folder / f"{name}.csv"
    path.write_text(
        head + "".join(f'{k},{k % 3},{k * k},"{quoted}","{quoted}"\n' for k in range(30)), encoding="utf-8"
    )
    return path


def tree(folder):
    return sorted(folder.rglob("*"))


def printable(said):
    return all(c.isprintable() or c == "\n" for c in said)


def test_a_log_reads_and_writes_as_its_rows(tmp_path, hostile):
    (log,) = read_logs(log_file(tmp_path, hostile))
    assert log.response.tolist() == [k * k for k in range(30)] and "\n" not in log.name
    write_log(log, tmp_path / "again.csv")
    (again,) = read_logs(tmp_path / "again.csv")
    assert again.response.tolist() == log.response.tolist() and again.time.tolist() == log.time.tolist()


@pytest.fixture(scope="module")
def plain_law():
    """The law of a plate whose log has a plain name."""
    return texts(controller.design(standin.posterior([standin.fitted("plain.csv")])), "dq_pi.h")[:2]


@pytest.mark.parametrize("hostile", [*map(study, TEXTS)], ids=ascii)
def test_what_a_run_prints_and_writes(tmp_path, hostile, plain_law):
    (log,) = read_logs(log_file(tmp_path, hostile))
    one = standin.fitted(log.name, metadata=log.metadata, notes=log.notes)
    posterior = standin.posterior([one])
    loop = controller.design(posterior)
    content = outputs.document(posterior, controller.as_dict(loop), [hostile])
    before = tree(tmp_path)

    file = io.StringIO()
    screen.show(
        content | {"files": {}}, text.derived(posterior.draws, content["parameters"]), Path("out"), file
    )
    said = file.getvalue()
    assert printable(said)

    page = html.render(content, posterior, {})
    assert "<script" not in page and "<img src=x" not in page and "\x1b" not in page and "\x9b" not in page
    assert "{{ 7 * 7 }}" in page if hostile.startswith("{{") else "49" not in hostile

    assert json.loads(outputs.to_json(content))["warnings"] == [hostile]  # whole, and ASCII
    outputs.to_json(content).encode("ascii")
    assert tree(tmp_path) == before

    controller.export_c(loop, tmp_path / "dq_pi.h")
    law = [
        (tmp_path / f"dq_pi.{end}").read_bytes() for end in ("h", "c")
    ]  # the same whatever the plate is called
    assert law == [one.encode("ascii") for one in plain_law]
    lines = (tmp_path / "dq_pi_plate.h").read_text(encoding="ascii").splitlines()
    assert [line.split()[1] for line in lines if line.startswith("#include")] == ['"dq_pi.h"']
    stamp = [line for line in lines if line.startswith(" * plate: ")]  # in letters that end no comment
    assert not [line for line in stamp if "*/" in line or "#" in line]
    record = [
        line for line in lines if line.startswith('#define DQ_PLATE_RECORD_HEADER "')
    ]  # in letters that end no string
    assert all(line.count('"') - line.count('\\"') == 2 for line in record)
    assert not [
        line for line in lines if "#error" in line or ("passwd" in line and line not in (*stamp, *record))
    ]


def test_a_refusal_is_one_line_and_its_mapping_file_is_toml(tmp_path, hostile):
    """A name that ends the comment that it stands in would write keys of its own."""
    path = log_file(tmp_path, hostile, header="a,b,c")
    with pytest.raises(LogError) as error:
        read_logs(path)
    assert "\n" not in str(error.value) and printable(text.clean(str(error.value)))
    given = tomllib.loads(error.value.mapping)
    assert given == tomllib.loads(text.clean(error.value.mapping))  # as it is printed
    assert (
        set(given) <= {"amplitude", "quantity", "phase_sign", "split_by", "columns"}
        and given["columns"] == {}
    )
    assert given["split_by"] == "log"


def test_a_header_that_is_refused(tmp_path, hostile):
    path = log_file(tmp_path, hostile, header="tiem_s,voltage_V,w_um")
    with pytest.raises(LogError, match="did you mean time_s") as error:
        read_logs(path)
    assert "\n" not in str(error.value) and printable(text.clean(str(error.value)))


@pytest.mark.parametrize("unit", ["V\n", "V\n0,1", "\x1b[2JV", "V\\x00", "V],x"])
def test_a_unit_is_a_unit(tmp_path, unit):
    (tmp_path / "log.csv").write_text("t,x\n0,1\n1,2\n")
    mapping = 'amplitude = "peak"\n[columns]\ntime = {column = "t", unit = "s"}\n'
    (tmp_path / "map.toml").write_text(mapping + f'w = {{column = "x", unit = {json.dumps(unit)}}}\n')
    with pytest.raises(LogError, match="unit"):
        read_logs(tmp_path / "log.csv", columns=tmp_path / "map.toml")


@pytest.mark.skipif(os.name != "posix", reason="no such names elsewhere")
def test_simulate_names_a_scene_without_obeying_it(tmp_path):
    command = [sys.executable, "-m", "sysid.scene.cli", "a\x1b[2J[/b].toml", "-o", str(tmp_path / "logs")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and "\x1b" not in done.stderr and "a\\u001b[2J[/b].toml" in done.stderr
