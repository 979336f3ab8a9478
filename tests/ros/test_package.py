"""The ROS 2 package `kbstore_ros`: what colcon, ros2 run and ros2 launch expect of it."""

import ast
import configparser
import os
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "ros2" / "kbstore_ros"


@pytest.fixture
def setup(monkeypatch):
    """The arguments of setup.py for setuptools."""
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


def test_the_executables_pass_arguments_on(monkeypatch):
    """Options of kbstore, and ROS's own, which ros2 launch puts at the end."""
    called = []
    monkeypatch.setattr("kbstore.cli.app.app", lambda words, prog_name: called.append(words))
    monkeypatch.setattr(sys, "argv", ["record", "--kb", "x", "--ros-args", "-r", "__ns:=/x"])
    runpy.run_path(str(PACKAGE / "kbstore_ros" / "executables.py"))["record"]()
    assert called == [["ros", "record", "--kb", "x", "--ros-args", "-r", "__ns:=/x"]]


def test_the_executables_run_with_the_python_of_the_shell():
    """Kbstore may be in a virtual environment, which colcon's own Python does not see."""
    settings = configparser.ConfigParser()
    settings.read(PACKAGE / "setup.cfg")
    assert settings["build_scripts"]["executable"] == "/usr/bin/env python3"
    assert settings["install"]["install_scripts"] == "$base/lib/kbstore_ros"


def test_a_python_without_kbstore_is_named(monkeypatch):
    """The executable's error names the Python without kbstore, and says what to do."""
    monkeypatch.setitem(sys.modules, "kbstore.cli.app", None)
    with pytest.raises(SystemExit, match=f"by {sys.executable}.* -m pip install kbstore"):
        runpy.run_path(str(PACKAGE / "kbstore_ros" / "executables.py"))


def test_colcon_builds_it(tmp_path):
    """Built and installed by colcon, ROS finds the package and its launch files, and the executables run."""
    pytest.importorskip("colcon_core", reason="colcon is not here: make test-ros2 brings it")
    from ament_index_python import get_package_share_path

    shutil.copytree(PACKAGE, tmp_path / "src" / "kbstore_ros")
    colcon = [sys.executable, "-m", "colcon", "--log-base", os.devnull, "build"]
    subprocess.run(colcon, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    prefix = tmp_path / "install" / "kbstore_ros"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AMENT_PREFIX_PATH", str(prefix))
        share = get_package_share_path("kbstore_ros")
    assert {path.name for path in (share / "launch").iterdir()} == {"experts_launch.py", "record_launch.py"}
    # as the setup files that colcon writes have it, in a shell with the Python that has kbstore
    (library,) = prefix.glob("lib/python*/site-packages")
    shell = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "PYTHONPATH": str(library)}
    for name, usage in (("experts", "kbstore ros plansys2"), ("record", "kbstore ros record")):
        command = [prefix / "lib" / "kbstore_ros" / name, "--help"]
        done = subprocess.run(command, env=shell, check=True, capture_output=True, text=True, timeout=60)
        assert usage in done.stdout
