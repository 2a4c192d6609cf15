"""Rotation-invariant perfect maps with a minimum Hamming distance: generation, verification, rendering, projection."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pattern_gen.pattern import Grid, Letter, Pattern, default_pattern

if TYPE_CHECKING:
    from pattern_gen.generation import generate

__all__ = ["Grid", "Letter", "Pattern", "default_pattern", "generate"]


def __getattr__(name: str) -> Any:
    if name == "generate":  # imported on use: the search's compiler costs a third of a second
        from pattern_gen.generation import generate

        return generate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
