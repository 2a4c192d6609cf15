"""The parts that know ROS: parameters, commands, status, the action."""
