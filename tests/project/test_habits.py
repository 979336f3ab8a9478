"""First contact, and rules for every committed file."""

import re
import shutil
import subprocess
import tomllib

import pytest

from tests.project.conftest import ROOT

_listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
COMMITTED = _listed.stdout.splitlines()


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_demonstration_installs_no_extra(tmp_path):
    """On a fresh machine `make demo` installs kbstore and its dependencies; `make test` installs the extra dev."""
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    recipes = {
        target: subprocess.run(
            ["make", "--dry-run", "--directory", tmp_path, target], capture_output=True, text=True, check=True
        ).stdout
        for target in ("demo", "test")
    }
    assert "pip install" in recipes["demo"]
    assert ".[" not in recipes["demo"]
    assert "[dev]" in recipes["test"]


@pytest.mark.parametrize(
    "extra", sorted(set(PROJECT["project"]["optional-dependencies"]) - {"dev", "bench", "browser"})
)
def test_an_extra_exists_when_its_code_does(extra):
    """Each distribution of a user's extra is named by the code that uses it."""
    sources = "".join(path.read_text() for path in (ROOT / "kbstore").rglob("*.py"))
    for requirement in PROJECT["project"]["optional-dependencies"][extra]:
        name = re.match(r"[\w-]+", requirement)[0].replace("-", "_")
        assert re.search(rf"\b{name}\b", sources), f"{extra}: nothing uses {requirement}"


def test_tests_show_why_anything_is_skipped():
    """Pytest runs with -ra, strict markers and strict configuration, and warnings are errors."""
    options = PROJECT["tool"]["pytest"]["ini_options"]
    assert {"-ra", "--strict-markers", "--strict-config"} <= set(options["addopts"].split())
    assert options["filterwarnings"][0] == "error"


def test_no_package_index_is_named():
    """No committed file has the host of a package index, as that is each user's choice."""
    hosts = re.compile(r"(?:pypi\.(?:org|python)|pythonhosted|conda\.anaconda|--(?:extra-)?index-url|--find-links)\b")
    found = []
    for name in COMMITTED:
        path = ROOT / name
        if name and path.is_file() and path.name != "test_habits.py" and hosts.search(path.read_text(errors="ignore")):
            found.append(name)
    assert not found
