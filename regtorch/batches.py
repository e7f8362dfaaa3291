"""How many poses or images are processed at once: enough to keep a device busy, little enough to fit its memory."""

_NUMBERS = {"cpu": 1 << 22}
_NUMBERS_ELSEWHERE = 1 << 26
"""Numbers of a batch, by device: a batch that stays in a CPU's cache is several times faster, while a GPU wants large
ones."""

_MOST = 4096
"""Largest batch: beyond it launching costs nothing any more."""

CACHED = 1 / 2
"""Share of the budget for steps that hold several arrays of a batch at the same time."""


def at_once(numbers_each: int, device: str = "cpu", *, share: float = 1.0, most: int = _MOST) -> int:
    """Largest batch, at least 1, of items that need ``numbers_each`` numbers; ``share`` is of the device's budget."""
    return max(1, min(most, int(share * _NUMBERS.get(device, _NUMBERS_ELSEWHERE)) // max(1, numbers_each)))
