"""The nodes of kbstore as executables of a ROS 2 package."""
