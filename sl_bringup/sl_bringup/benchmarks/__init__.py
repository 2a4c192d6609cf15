"""The performance table: rows of the packages, and the decoder as a node."""
