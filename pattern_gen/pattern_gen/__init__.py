"""Rotation-invariant perfect maps with a minimum Hamming distance: generation, verification, rendering, projection."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pattern_gen.catalogue import default_pattern
from pattern_gen.pattern import Grid, Letter, Pattern

if TYPE_CHECKING:
    from pattern_gen.generation import enlarge, generate

__all__ = ["Grid", "Letter", "Pattern", "default_pattern", "enlarge", "generate"]


def __getattr__(name: str) -> Any:
    if name in ("enlarge", "generate"):  # imported on use: the search's compiler costs a third of a second
        from pattern_gen import generation

        return getattr(generation, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
