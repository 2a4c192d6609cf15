"""The package's exceptions."""

from sl_common.errors import StructuredLightError


class ProcessError(StructuredLightError):
    """A process could not be started or ended on its own."""


class DemoError(StructuredLightError):
    """A step of the demo did not come about."""


class BagError(StructuredLightError):
    """A bag is missing, unreadable or holds something else than expected."""


class BenchmarkError(StructuredLightError):
    """A measurement did not come about."""
