"""minidual's plant and arbiter on ROS 2 topics, through DDS without ROS."""
