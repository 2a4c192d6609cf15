"""Errors of the simulated cell."""

from sl_common.errors import StructuredLightError


class CellError(StructuredLightError):
    """The cell cannot do what it was asked."""
