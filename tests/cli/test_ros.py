"""The nodes of ROS, without ROS: missing packages are named, and ROS arguments are passed on."""

import sys
from types import SimpleNamespace

import pytest


@pytest.mark.parametrize("missing", ["rospy", "rosplan_knowledge_msgs.msg"])
def test_without_ros_1_the_error_names_the_package(run, monkeypatch, missing):
    """The error is one line that names the package, and what to do."""
    for name in ("rospy", "rosplan_knowledge_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, None if name == missing else sys)
    done = run("ros", "rosplan", "--url", "robot.db", "__name:=knowledge_base")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"kbstore: ROSPlan's node needs {missing}, which cannot be imported")
    assert "source devel/setup.bash" in done.err


@pytest.mark.parametrize("command", ["plansys2", "record"])
@pytest.mark.parametrize("missing", ["rclpy", "plansys2_msgs"])
def test_without_ros_2_the_error_names_the_package(run, monkeypatch, command, missing):
    """The error is one line that names the failed import, and what to do."""
    monkeypatch.setitem(sys.modules, missing, None)
    done = run("ros", command, "--url", "robot.db")
    assert (done.code, done.out) == (2, "")
    assert "rclpy and plansys2_msgs, of which one cannot be imported" in done.err
    assert "source install/setup.bash" in done.err


def test_the_recorder_needs_a_store(run, monkeypatch):
    """The error comes before ROS is looked for."""
    monkeypatch.delenv("KBSTORE_URL")
    assert "which store?" in run("ros", "record").err


ROS = ["--ros-args", "-r", "__ns:=/kenny", "-p", "use_sim_time:=true", "--log-level", "debug"]


@pytest.mark.parametrize(("command", "module"), [("plansys2", "plansys2_node"), ("record", "recorder_node")])
@pytest.mark.parametrize("separated", [[], ["--"]])
def test_arguments_after_ros_args_are_passed_on(run, monkeypatch, command, module, separated):
    """Everything from --ros-args on is passed to ROS, options included."""
    called = []
    node = SimpleNamespace(run=lambda *arguments: called.append(arguments))
    monkeypatch.setitem(sys.modules, f"kbstore.ros.{module}", node)
    assert run("ros", command, "--url", "robot.db", "--kb", "kenny", *separated, *ROS).code == 0
    ((url, kb, *_, given),) = called
    assert (url, kb, given) == ("robot.db", "kenny", ROS)


@pytest.mark.parametrize("command", ["plansys2", "record"])
def test_an_unknown_option_is_refused(run, command):
    """A misspelt option is not passed to ROS, which would not notice."""
    done = run("ros", command, "--ulr", "robot.db", "--ros-args", "-r", "__ns:=/kenny")
    assert done.code == 2
    assert "there is no option --ulr; what ROS reads comes after --ros-args" in done.err
