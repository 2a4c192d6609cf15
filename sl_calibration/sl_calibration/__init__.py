"""Calibration of camera, projector, hand-eye and colours, with and without a grid; triangulation."""
