"""The nodes of ROS, without ROS: what is missing is named."""

import sys

import pytest


@pytest.mark.parametrize("missing", ["rospy", "rosplan_knowledge_msgs.msg"])
def test_without_ros_1_the_node_says_what_it_needs(run, monkeypatch, missing):
    """One line that names the package, and what to do."""
    for name in ("rospy", "rosplan_knowledge_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, None if name == missing else sys)
    done = run("ros", "rosplan", "--url", "robot.db", "__name:=knowledge_base")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"kbstore: ROSPlan's node needs {missing}, which cannot be imported")
    assert "source devel/setup.bash" in done.err


@pytest.mark.parametrize("command", ["plansys2", "record"])
@pytest.mark.parametrize("missing", ["rclpy", "plansys2_msgs"])
def test_without_ros_2_the_nodes_say_what_they_need(run, monkeypatch, command, missing):
    """One line that names what could not be imported, and what to do."""
    monkeypatch.setitem(sys.modules, missing, None)
    done = run("ros", command, "--url", "robot.db")
    assert (done.code, done.out) == (2, "")
    assert "rclpy and plansys2_msgs, of which one cannot be imported" in done.err
    assert "source install/setup.bash" in done.err


def test_the_recorder_needs_a_store(run, monkeypatch):
    """It is asked for before ROS is looked for."""
    monkeypatch.delenv("KBSTORE_URL")
    assert "which store?" in run("ros", "record").err
