"""kbstore on a ROS graph: handlers without ROS, and the nodes and files that they serve."""
