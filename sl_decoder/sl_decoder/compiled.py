"""The one way in which this package compiles its loops.

Cached on disk (the build and a node's start-up compile, never a callback); divisions follow numpy; floating-point
sums may be reordered, while nan and inf keep their meaning.
"""

from typing import Any

from numba import njit

compiled: Any = njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
