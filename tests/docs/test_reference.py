"""The reference agrees with the docstrings, and every example in a docstring is right."""

import doctest
import importlib
import importlib.util
import pkgutil
from pathlib import Path

import pytest

import kbstore
from kbstore.cli.commands import COMMANDS
from tests.docs.blocks import ROOT

MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(kbstore.__path__, "kbstore.")
    if not module.name.endswith("__main__") and ".migrations" not in module.name
)


@pytest.fixture(scope="module")
def reference():
    """The script that writes the page."""
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs" / "reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_public_name_is_in_the_reference(reference):
    """Each name of `kbstore.__all__` has a heading of its own, and a docstring."""
    listed = [name for names in reference.groups().values() for name in names]
    assert sorted(listed) == sorted({*kbstore.__all__, *reference.NOT_EXPORTED})
    assert len(listed) == len(set(listed))


def test_the_reference_is_up_to_date(reference):
    """The page is generated from the docstrings; if it differs, run: python docs/reference.py."""
    assert (ROOT / "docs" / "reference.md").read_text(encoding="utf-8") == reference.page()


def test_every_command_is_documented():
    """docs/command-line.md has each command with its group, and each option of a command's own."""
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    for command in COMMANDS:
        assert f"`kbstore {command.name}" in page


FROM_A_ROS_DISTRIBUTION = {"plansys2_msgs", "rclpy"}
"""Packages that no extra installs: a module that imports one has no examples."""


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings(name):
    """Every example in a docstring has the printed output."""
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name in FROM_A_ROS_DISTRIBUTION:
            source = importlib.util.find_spec(name).origin
            assert ">>>" not in Path(source).read_text(encoding="utf-8"), f"{name} cannot be run here"
            return
        pytest.fail(f"{name} needs {error.name}, which the extra dev should bring")
    assert doctest.testmod(module).failed == 0
