"""Errors of this package; all of them are StructuredLightError, so one handler catches everything."""

from __future__ import annotations

from sl_common.errors import StructuredLightError


class PatternError(StructuredLightError):
    """A pattern's values contradict each other (for example a symbol without a letter)."""


class PatternFileError(PatternError):
    """A pattern file cannot be used; `path`, `line` (from 1; None if not known) and `reason` are kept for callers."""

    def __init__(self, path: object, line: int | None, reason: str) -> None:
        self.path = str(path)
        self.line = line
        self.reason = reason
        where = self.path if line is None else f"{self.path}:{line}"
        super().__init__(f"{where}: {reason}")


class SearchError(StructuredLightError):
    """A search was asked for something impossible, or found nothing within its limits."""


class ProjectionError(StructuredLightError):
    """The projector was asked to show a frame that does not exist."""
