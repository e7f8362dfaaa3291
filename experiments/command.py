"""What commands of studies share: threads, and how they end where what is asked for cannot be done."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numba
import torch

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


def use_threads(threads: int) -> None:
    """For torch and for numba; raises ``RegtorchError`` where the machine has fewer."""
    most = numba.config.NUMBA_NUM_THREADS
    if not (isinstance(threads, int) and 1 <= threads <= most):
        raise RegtorchError(f"threads={threads}: expected a whole number from 1 to {most}")
    torch.set_num_threads(threads)
    numba.set_num_threads(threads)
