"""The one exception that is meant for the user."""


class RegtorchError(ValueError):
    """Bad input. The message is one line that names the file, the value and the expectation."""
