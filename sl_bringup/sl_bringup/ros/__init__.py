"""What of this package speaks to running nodes: all else works on what came of it."""
