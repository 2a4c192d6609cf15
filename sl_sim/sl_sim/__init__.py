"""A simulated cell: six-axis arm, ray-cast eye-in-hand camera, projector light, arm driver that counts limit
violations.
"""
