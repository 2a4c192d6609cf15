"""What the commands share: sizes, and a progress line."""

from __future__ import annotations

import argparse
import shutil
import sys
from typing import TYPE_CHECKING

from pattern_gen.search_request import Progress

if TYPE_CHECKING:
    from tqdm import tqdm


def size(text: str) -> tuple[int, int]:
    """A 'WxH' argument."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form 1024x768") from None
    if width < 1 or height < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: both numbers must be positive")
    return width, height


class ProgressLine:
    """A progress bar on a terminal, shown once a search has taken two seconds."""

    def __init__(self, time_limit: float) -> None:
        self._limit = time_limit
        self._bar: tqdm | None = None

    def __call__(self, progress: Progress) -> None:
        """Show where the search stands."""
        if progress.seconds < 2.0 or not sys.stderr.isatty():
            return
        if self._bar is None:
            from tqdm import tqdm

            columns, lines = shutil.get_terminal_size()  # a terminal of unknown size reports 0x0; this falls back
            self._bar = tqdm(
                total=self._limit,
                unit="s",
                bar_format="{desc} |{bar}| {n:.0f}/{total:.0f} s",
                leave=False,
                ncols=columns,
                nrows=lines,
            )
        best = "none yet" if progress.best is None else f"{progress.best[0]}x{progress.best[1]}"
        self._bar.set_description_str(
            f"best {best}, trying {progress.rows}x{progress.cols} ({100 * progress.filled:.0f} %)", refresh=False
        )
        self._bar.n = min(progress.seconds, self._limit)
        self._bar.refresh()

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()
