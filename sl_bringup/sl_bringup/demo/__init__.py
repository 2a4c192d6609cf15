"""The demo: the whole chain on a simulated cell, watched from outside and judged against the cell's truth."""
