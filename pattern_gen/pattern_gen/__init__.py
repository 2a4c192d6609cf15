"""Rotation-invariant perfect maps with a minimum Hamming distance: generation, verification, rendering, projection."""
