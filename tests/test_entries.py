"""Entries of the documentation: one for each key that a finding may have and for each error, and none of what
is not; the command names them."""

import ast
import re
from pathlib import Path

import pytest

from sysid.command import cli
from sysid.effects.registry import ADOPTED
from sysid.verdict.finding import entry

ROOT = Path(__file__).parents[1]
PACKAGES = ("sysid", "controller", "stimulator")
CALLED = {"Finding": 0, "Term": 0, "Found": 3, "of_one": 1}  # at which place their name stands


def trees(*folders):
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield ast.parse(path.read_text(encoding="utf-8"))


def keys():
    """What stands in the source where findings are made; constants by their values."""
    found = set(ADOPTED)
    for tree in trees("sysid/verdict", "sysid/effects", "sysid/adoption"):
        constants = {
            node.targets[0].id: node.value.value
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        }
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            place = CALLED.get(getattr(call.func, "id", ""))
            name = None if place is None or len(call.args) <= place else call.args[place]
            if isinstance(name, ast.Constant):
                found.add(name.value)
            elif isinstance(name, ast.Name) and name.id in constants:
                found.add(constants[name.id])
    return found


def errors():
    return {
        node.name
        for tree in trees(*PACKAGES)
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and node.name.endswith("Error")
    }


def headings(level, of):
    """The headings of one level under one of the second."""
    text = (ROOT / "docs" / "errors.md").read_text(encoding="utf-8")
    part = re.search(rf"^## {of}\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    return re.findall(rf"^{'#' * level} (.+)$", part.group(1), re.MULTILINE)


def test_each_finding_has_its_entry():
    written = headings(4, "Findings")
    assert sorted(written) == sorted(keys())


def test_each_error_has_its_entry():
    written = headings(3, "Refusals")
    assert sorted(written) == sorted(errors())


def slug(heading):
    """The anchor that a repository's page and the site give a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


@pytest.mark.parametrize("key", sorted(keys()))
def test_the_address_is_that_of_the_heading(key):
    assert entry(key) == f"docs/errors.md#{slug(key)}"


def test_the_command_names_the_entries_once_below_the_warnings(capsys):
    keys = ["rows_lost", "delay", "rows_lost"]
    content = {"warnings": ["one", "two"], "findings": [{"key": key} for key in keys]}
    cli._say(content, "{}", None, ROOT, as_json=True)
    said = capsys.readouterr()
    last = "see docs/errors.md#rows_lost, docs/errors.md#delay"
    assert (said.out, said.err.splitlines()) == ("{}", ["warning: one", "warning: two", last])


def test_without_findings_nothing_is_named(capsys):
    cli._say({"warnings": ["one"], "findings": []}, "{}", None, ROOT, as_json=True)
    assert capsys.readouterr().err == "warning: one\n"
