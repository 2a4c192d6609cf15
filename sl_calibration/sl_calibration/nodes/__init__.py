"""ROS nodes: parameters, messages, and calls into the core."""
