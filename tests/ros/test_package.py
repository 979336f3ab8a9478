"""The ROS 2 package `kbstore_ros`: what colcon, ros2 run and ros2 launch expect of it."""

import ast
import runpy
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "ros2" / "kbstore_ros"


@pytest.fixture
def setup(monkeypatch):
    """What setup.py tells setuptools."""
    found = {}
    monkeypatch.setitem(sys.modules, "setuptools", type("Setuptools", (), {"setup": staticmethod(found.update)}))
    runpy.run_path(str(PACKAGE / "setup.py"))
    return found


def test_the_package_is_described_twice_alike(setup):
    """package.xml and setup.py have the same name and version, that of kbstore; it is built as ament_python."""
    described = ElementTree.parse(PACKAGE / "package.xml").getroot()
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert (described.findtext("name"), setup["name"]) == ("kbstore_ros", "kbstore_ros")
    assert (described.findtext("version"), setup["version"]) == (version, version)
    assert described.findtext("export/build_type") == "ament_python"


def test_the_package_is_found_and_runs(setup):
    """The marker in the resource index, the launch files and the modules of the executables exist."""
    for _, files in setup["data_files"]:
        for name in files:
            assert (PACKAGE / name).is_file()
    assert ("share/ament_index/resource_index/packages", ["resource/kbstore_ros"]) in setup["data_files"]
    listed = {name for folder, files in setup["data_files"] if folder.endswith("launch") for name in files}
    assert listed == {f"launch/{path.name}" for path in (PACKAGE / "launch").glob("*.py")}
    for script in setup["entry_points"]["console_scripts"]:
        module, function = script.partition(" = ")[2].split(":")
        tree = ast.parse((PACKAGE / f"{module.replace('.', '/')}.py").read_text())
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (["--ros-args", "-r", "__ns:=/x"], ["ros", "record", "--", "--ros-args", "-r", "__ns:=/x"]),
        (["--url", "a.db"], ["ros", "record", "--url", "a.db", "--"]),
        (["--kb", "x", "--ros-args"], ["ros", "record", "--kb", "x", "--", "--ros-args"]),
    ],
)
def test_the_executables_pass_arguments_on(monkeypatch, arguments, command):
    """ROS's own arguments, which ros2 launch puts at the end, go behind ``--``."""
    called = []
    monkeypatch.setattr("kbstore.cli.app.app", lambda words, prog_name: called.append(words))
    monkeypatch.setattr(sys, "argv", ["record", *arguments])
    runpy.run_path(str(PACKAGE / "kbstore_ros" / "executables.py"))["record"]()
    assert called == [command]
