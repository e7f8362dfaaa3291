"""Where the Triton kernels run in tests: on a GPU, or without one in Triton's interpreter."""

import os
from importlib.util import find_spec

import pytest
import torch

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
if DEVICE == "cpu":
    os.environ.setdefault("TRITON_INTERPRET", "1")  # Triton reads this when it is first imported

needs_triton = pytest.mark.skipif(find_spec("triton") is None, reason="the package 'triton' is not installed")
