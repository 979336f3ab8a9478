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
