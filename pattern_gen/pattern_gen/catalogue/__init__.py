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


def default_pattern() -> Pattern:
    """The shipped pattern of the paper's experiment: 44x58 spots, three colours in two intensities, h = 3, 1024x768."""
    return load_ready_pattern("square_44x58_a6_h3")
