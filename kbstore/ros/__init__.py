"""kbstore on a ROS graph: handlers, which need no ROS, and the nodes and bags that use them."""
