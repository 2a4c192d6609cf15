"""What two or more packages share: rigid transforms, camera models, kinematics, ROS conversions."""
