"""Rows that the packages' own benchmark modules give."""

import importlib
import importlib.util
from collections.abc import Iterable
from typing import Any

from sl_bringup.demo.report import Row

PACKAGES = ("pattern_gen", "sl_decoder", "sl_calibration", "arm_positioner", "sl_sim")


def available() -> list[str]:
    """Return the packages that have a benchmark module."""
    return [p for p in PACKAGES if importlib.util.find_spec(f"{p}.benchmark") is not None]


def package_rows(package: str) -> list[Row]:
    """Run a package's ``benchmark.rows()`` and return its rows: (name, value, unit[, limit])."""
    module: Any = importlib.import_module(f"{package}.benchmark")
    return [_row(package, entry) for entry in module.rows()]


def _row(package: str, entry: Iterable[Any]) -> Row:
    name, value, unit, *rest = entry
    limit = rest[0] if rest else None
    number = float(value)
    digits = 0 if abs(number) >= 1000 else 1 if abs(number) >= 10 else 3
    return Row(f"{package}: {name}", number, unit, None if limit is None else float(limit), digits=digits)
