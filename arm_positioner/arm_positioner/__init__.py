"""Positions an eye-in-hand camera in front of an object seen in a point cloud, within the limits of the arm."""
