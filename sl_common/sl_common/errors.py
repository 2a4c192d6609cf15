"""The exception base class of the stack."""


class StructuredLightError(Exception):
    """Base of every error that the stack raises on purpose.

    The message is one line that says what was wrong, with the number, and what to do next: a command prints it and
    exits with 1, a node logs it and carries on.
    """


class InvalidInputError(StructuredLightError):
    """Data from outside (a file, a message, an argument) cannot be used."""


class CalibrationFileError(StructuredLightError):
    """A calibration file is missing, unreadable or incomplete."""


class ModelError(StructuredLightError):
    """A robot or camera model does not fit its description or its data."""
