"""How a study's command line ends where the user has asked for what cannot be done."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from regtorch.arguments import BAD_INPUT
from regtorch.errors import RegtorchError


@contextmanager
def told_in_one_line(study: str) -> Iterator[None]:
    """Makes a ``RegtorchError`` one line on stderr and exit code 2."""
    try:
        yield
    except RegtorchError as error:
        print(f"{study}: error: {error}", file=sys.stderr)
        raise SystemExit(BAD_INPUT) from None
