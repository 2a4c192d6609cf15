"""What of the cell node speaks ROS."""
