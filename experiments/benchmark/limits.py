"""Limits of the machine, and the share of them that a projector needs."""

import platform
import time
from pathlib import Path
from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import njit, prange
from torch import Tensor

from experiments.benchmark.timing import use_threads
from regtorch.geometry import Detector, cone_beam_rays
from regtorch.imaging import Volume

GROUP_BYTES = 16
"""The four float32 neighbours of a bilinear sample: one read, for a projector that keeps them together."""

_GROUPS = 1 << 14  # 256 KiB: fits in the second-level cache of one core, not in the first
_READS = 1 << 24
_HASH = np.uint64(0x9E3779B97F4A7C15)
_TILE_ROWS, _TILE_COLUMNS = 8, 16


def device_name(device: str = "cpu") -> str:
    if device != "cpu":
        return torch.cuda.get_device_name(device)
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    return names[0].split(":")[1].strip() if names else platform.processor() or platform.machine()


def gathers_per_second(threads: int, repeats: int = 5) -> float:
    """How many groups of 16 bytes the machine reads per second from scattered places, all threads together.

    Each thread reads from its own 256 KiB, at addresses that a multiplicative hash scatters: any order that a
    prefetcher could guess, or that hits the first-level cache twice in a row, would read faster. Reads do not depend on
    each other, and each is added, as two float64, to a running sum, so that nothing can be left out. It is the best of
    ``repeats`` turns. No interpolation, no positions: a projector that reached this would do nothing but read.
    """
    use_threads(threads)
    groups = np.ones((threads, _GROUPS), np.complex128)
    _gather(groups, 1 << 10)
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        _gather(groups, _READS)
        seconds.append(time.perf_counter() - start)
    return threads * _READS / min(seconds)


@njit(parallel=True, nogil=True)
@no_type_check
def _gather(groups, reads):
    threads, n = groups.shape
    quarter = np.uint64(reads // 4)
    sums = np.zeros(threads, np.complex128)
    shift = np.uint64(64 - int(np.log2(n)))
    for thread in prange(threads):
        own = groups[thread]
        # Four sums, or each addition would wait for the one before.
        a = b = c = d = np.complex128(0)
        for read in range(quarter):
            a += own[(read * _HASH) >> shift]
            b += own[((read + quarter) * _HASH) >> shift]
            c += own[((read + np.uint64(2) * quarter) * _HASH) >> shift]
            d += own[((read + np.uint64(3) * quarter) * _HASH) >> shift]
        sums[thread] = a + b + c + d
    return sums


def bytes_per_second(device: str, megabytes: int, repeats: int = 20) -> float:
    """How fast a GPU sums a tensor of that size again and again: from its cache if it fits there, else from memory."""
    turns = max(1, 4096 // megabytes)
    tensor = torch.ones(megabytes << 18, device=device)[None].expand(turns, -1)
    best = float("inf")
    for _ in range(repeats):
        torch.cuda.synchronize(device)
        start = time.perf_counter()
        tensor.sum(dim=1)
        torch.cuda.synchronize(device)
        best = min(best, time.perf_counter() - start)
    return turns * megabytes * 2**20 / best


def samples_all(volume: Volume, poses: Float[Tensor, "b 9"], detector: Detector, view: str) -> int:
    """Joseph's samples over the whole volume, per pose: rays times slices (times classes), whatever they meet."""
    slices = volume.data.shape[-1 - _main_axis(_rays(volume, poses, detector, view))]
    return detector.rows * detector.columns * slices * volume.data.shape[:-3].numel()


def samples_needed(volume: Volume, poses: Float[Tensor, "b 9"], detector: Detector, view: str) -> float:
    """Samples per pose that are left where empty tiles of 8 x 16 pixels are skipped slice by slice.

    A tile counts in a slice if the four neighbours of any of its samples are not all zero. A projector that skips
    by tiles of that size takes these at least; regtorch takes some more, as it decides by boxes around tiles and by
    blocks of voxels. So what is derived from this count is a lower bound.
    """
    rays = _rays(volume, poses, detector, view)
    main = _main_axis(rays)
    a, b = (axis for axis in range(3) if axis != main)
    parts = np.ascontiguousarray(rays.reshape(-1, 4, 3)[:, :, [a, b, main]])
    count = 0
    for occupied in volume.data.reshape(-1, *volume.data.shape[-3:]).cpu().numpy() != 0:
        padded = np.pad(np.moveaxis(occupied, 2 - main, 0), ((0, 0), (1, 1), (1, 1)))
        cells = padded[:, :-1, :-1] | padded[:, 1:, :-1] | padded[:, :-1, 1:] | padded[:, 1:, 1:]
        count += _count(np.ascontiguousarray(cells), parts, detector.rows, detector.columns)
    return count / len(poses)


@njit(nogil=True)
@no_type_check
def _count(cells, rays, rows, columns):
    count = 0
    for source, first, column_step, row_step in rays:
        for row0 in range(0, rows, _TILE_ROWS):
            for column0 in range(0, columns, _TILE_COLUMNS):
                row1, column1 = min(row0 + _TILE_ROWS, rows), min(column0 + _TILE_COLUMNS, columns)
                for k in range(cells.shape[0]):
                    if _any(cells[k], k, source, first, column_step, row_step, row0, row1, column0, column1):
                        count += (row1 - row0) * (column1 - column0)
    return count


@njit(nogil=True)
@no_type_check
def _any(cells, k, source, first, column_step, row_step, row0, row1, column0, column1):
    for row in range(row0, row1):
        for column in range(column0, column1):
            pixel = first + column * column_step + row * row_step
            t = (k - source[2]) / (pixel[2] - source[2])
            a = int(np.floor(source[0] + t * (pixel[0] - source[0]))) + 1
            b = int(np.floor(source[1] + t * (pixel[1] - source[1]))) + 1
            inside = 0 <= t <= 1 and 0 <= a < cells.shape[1] and 0 <= b < cells.shape[0]
            if inside and cells[b, a]:
                return True
    return False


def _rays(volume: Volume, poses: Tensor, detector: Detector, view: str) -> np.ndarray:
    return cone_beam_rays(poses.cpu().double(), detector, view, volume.voxel_from_ct).numpy()


def _main_axis(rays: np.ndarray) -> int:
    """The axis that the first pose's first ray runs along most; in a frontal or lateral view all do."""
    return int(np.abs(rays[0, 3:6] - rays[0, :3]).argmax())
