"""Robust weights reduce the parts that a DRR does not explain, and change nothing else."""

import torch

from regtorch.similarity.robust import explained_weight


def _image(seed: int = 0) -> torch.Tensor:
    noise = torch.rand(60, 50, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.avg_pool2d(noise[None], 5, stride=1, padding=2)[0]


def test_an_explained_image_counts_alike_everywhere_whatever_its_gain_and_offset():
    moving, ones = _image(), torch.ones(60, 50)
    weight = explained_weight(moving, 3 * moving + 7 + 1e-4 * _image(1), ones)
    assert float(weight[5:-5, 5:-5].min()) > 0.1 * float(weight.max())
    assert float(weight.max()) <= 1
    torch.testing.assert_close(explained_weight(moving, 3 * moving + 7, ones), ones, atol=1e-3, rtol=0)


def test_a_bright_wire_counts_little():
    moving, ones = _image(), torch.ones(60, 50)
    fixed = moving + 0.01 * _image(1)
    fixed[:, 24:26] += 2
    weight = explained_weight(moving, fixed, ones)
    assert float(weight[:, 22:28].mean()) < 0.05 * float(weight[:, :15].mean())


def test_what_is_masked_stays_masked_and_leaves_no_trace():
    moving, weight = _image(), torch.ones(60, 50)
    weight[:20] = 0
    fixed = moving + 0.1 * _image(1)
    other = fixed.clone()
    other[:15] = 5
    found = explained_weight(moving, fixed, weight)
    assert bool((found[:20] == 0).all())
    torch.testing.assert_close(explained_weight(moving, other, weight)[25:], found[25:])


def test_the_edge_of_a_mask_is_no_residual():
    moving, weight = _image(), torch.ones(60, 50)
    weight[:20] = 0
    fixed = torch.where(weight > 0, moving + 0.1 * _image(1), 3.0)
    found = explained_weight(moving, fixed, weight)
    assert float(found[20:23].mean()) > 0.5 * float(found[30:].mean())


def test_gain_and_offset_of_the_radiograph_do_not_matter():
    moving, fixed, ones = _image(), _image() + _image(1), torch.ones(60, 50)
    torch.testing.assert_close(explained_weight(moving, fixed, ones), explained_weight(moving, 40 * fixed - 3, ones))
