"""The first five minutes, and what every committed file has to keep to."""

import re
import subprocess
import tomllib

import pytest

from tests.project.conftest import ROOT

_listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
COMMITTED = _listed.stdout.splitlines()


@pytest.mark.parametrize("command", ["make demo", "make test"])
def test_the_readme_begins_with_two_commands(command):
    """Both commands stand on lines of their own among the first 60 of the README."""
    assert command in (ROOT / "README.md").read_text().splitlines()[:60]


@pytest.mark.parametrize("target", ["demo", "test", "lint", "bench"])
def test_each_target_calls_a_tool_itself(target):
    """Each target of the Makefile is a line or two."""
    makefile = (ROOT / "Makefile").read_text()
    recipe = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert recipe
    assert 1 <= recipe[1].count("\n") <= 2


def test_tests_show_why_anything_is_skipped():
    """Pytest runs with -ra, strict markers and strict configuration, and warnings are errors."""
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    assert {"-ra", "--strict-markers", "--strict-config"} <= set(options["addopts"].split())
    assert options["filterwarnings"][0] == "error"


def test_no_package_index_is_named():
    """No committed file names the host of a package index: where packages come from is each user's own affair."""
    hosts = re.compile(r"(?:pypi\.(?:org|python)|pythonhosted|conda\.anaconda|--(?:extra-)?index-url|--find-links)\b")
    found = []
    for name in COMMITTED:
        path = ROOT / name
        if name and path.is_file() and path.name != "test_habits.py" and hosts.search(path.read_text(errors="ignore")):
            found.append(name)
    assert not found
