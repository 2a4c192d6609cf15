"""Memory that the process keeps between images."""

from __future__ import annotations

import numpy as np

LARGEST_BLOCK = (32 << 20) - (1 << 16)  # bytes: the most that glibc's threshold follows, less its own bookkeeping
AT_HAND = 24 << 20  # bytes that are there for the first image: what one of 1280x960 takes, and a reserve


def keep_freed_memory() -> None:
    """Have the C library keep what an image's arrays took for the next image's.

    glibc returns large blocks to the system when they are freed and gets them back page by page, which takes a third of
    the time of a decoding. Its limit follows the largest block that was freed so far (mallopt(3), M_MMAP_THRESHOLD):
    one is freed here that nobody has written to. Other C libraries do not mind.
    """
    np.empty(LARGEST_BLOCK, np.uint8)
    np.ones(AT_HAND, np.uint8)
