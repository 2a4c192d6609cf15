"""Ready maps that ship with the package, by name."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from pattern_gen.errors import PatternError
from pattern_gen.pattern import Pattern

FOLDER = Path(__file__).parent


def ready_names() -> list[str]:
    """Names of the ready patterns."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


@cache
def load_ready_pattern(name: str) -> Pattern:
    """A ready pattern by its name. Raises PatternError with the known names."""
    if name not in ready_names():
        raise PatternError(f"no ready pattern {name!r}; known: {', '.join(ready_names())}")
    return Pattern.load(FOLDER / f"{name}.yaml")
