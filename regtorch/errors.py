"""The exception for wrong input."""


class RegtorchError(ValueError):
    """Bad input. The message is one line that names the file, the value and what was expected."""
