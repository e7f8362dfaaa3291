"""The state of all running starts, one row each. An ended start is a row dropped."""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from regtorch.optimization.start import Start


@dataclass
class Rows:
    """Symbols of the tutorial, in the coordinates of ``Start``: a starts, n parameters, room for G generations."""

    start: Int[Tensor, " a"]  # number of the start
    m: Float[Tensor, "a n"]
    sigma: Float[Tensor, " a"]
    C: Float[Tensor, "a n n"]
    B: Float[Tensor, "a n n"]
    D: Float[Tensor, "a n"]
    p_sigma: Float[Tensor, "a n"]
    p_c: Float[Tensor, "a n"]
    first_length: Float[Tensor, " a"]  # first length of the longest axis
    best_u: Float[Tensor, "a n"]
    best_cost: Float[Tensor, " a"]
    best: Float[Tensor, "a G"]  # lowest cost of each generation
    median: Float[Tensor, "a G"]

    def keep(self, rows: Bool[Tensor, " a"]) -> None:
        """Drop the other rows."""
        for field in fields(self):
            setattr(self, field.name, getattr(self, field.name)[rows])


def first_rows(begin: Start) -> Rows:
    """All starts before their first generation."""
    n = len(begin.u)
    B, D = principal_axes(begin.shape)
    zero, infinite = torch.zeros_like(begin.u), torch.full((n,), torch.inf, dtype=torch.float64)
    one, none = torch.ones(n, dtype=torch.float64), torch.empty(n, 0, dtype=torch.float64)
    return Rows(torch.arange(n), begin.u, one, begin.shape, B, D, zero, zero, D[:, -1], begin.u, infinite, none, none)


def principal_axes(C: Float[Tensor, "a n n"]) -> tuple[Float[Tensor, "a n n"], Float[Tensor, "a n"]]:
    """C = B D^2 B^T, D ascending.

    Blocks are padded to multiples of 8. LAPACK's last digits depend on a matrix's alignment in memory: without
    padding, on its place in the batch. The padding's eigenvalues come last, and its axes do not mix with the others.
    """
    a, n, _ = C.shape
    size = -(-n // 8) * 8
    padded = C.new_zeros(a, size, size)
    padded.diagonal(dim1=1, dim2=2).copy_(2 * C.diagonal(dim1=1, dim2=2).sum(1, keepdim=True).expand(a, size))
    padded[:, :n, :n] = C
    squares, B = torch.linalg.eigh(padded)
    return B[:, :n, :n].contiguous(), squares[:, :n].clamp_min(torch.finfo(C.dtype).tiny).sqrt()
