"""Optimisation of many starts at once. It knows nothing of X-rays: torch tensors in, torch tensors out."""

from regtorch.optimization.evolution_strategy import cma_es
from regtorch.optimization.optimum import Optimum
from regtorch.optimization.partition import kd_partition, multi_start
from regtorch.optimization.pycma_peer import pycma

__all__ = ["Optimum", "cma_es", "kd_partition", "multi_start", "pycma"]
