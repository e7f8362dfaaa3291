"""One budget says how many items are processed at once."""

import pytest

from regtorch.batches import CACHED, at_once


@pytest.mark.parametrize(
    ("numbers_each", "device", "options", "expected"),
    [
        (1 << 12, "cpu", {}, 1 << 10),
        (3 << 10, "cpu", {}, (1 << 12) // 3),
        (1 << 12, "cpu", {"share": CACHED}, 1 << 9),
        (1 << 12, "cpu", {"most": 64}, 64),
        (1 << 30, "cpu", {"most": 64}, 1),
        (1 << 20, "cuda", {}, 1 << 6),
        (0, "cpu", {"most": 7}, 7),
    ],
)
def test_as_many_as_fit_but_at_least_one(numbers_each, device, options, expected):
    assert at_once(numbers_each, device, **options) == expected
