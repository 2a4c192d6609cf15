"""What two or more packages of the structured-light stack share: transforms, camera models, kinematics, ROS conversions."""
