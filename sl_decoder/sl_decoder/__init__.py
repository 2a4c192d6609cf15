"""Decodes single-shot structured light: camera images to camera-projector correspondences."""
