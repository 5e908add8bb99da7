"""ROS 2 without ROS: an exported workspace, recordings as MCAP, and topics over DDS."""
