"""MCAP bags: written and read with rosbags, which works with and without a full ROS installation."""
