"""The grid of a CT and its place in the patient."""

import torch

from regtorch.imaging import Volume


def test_a_point_is_held_to_the_outer_faces_of_the_voxels():
    patient_from_voxel = torch.tensor([[0, -2.0, 0, 10], [3, 0, 0, -20], [0, 0, 4, 5], [0, 0, 0, 1]])
    ct = Volume.from_grid(torch.zeros(2, 5, 7), patient_from_voxel)  # 7 x 5 x 2 voxels along i, j, k
    inside = [(10, -20, 5), (2, -2, 9), (10.9, -21.4, 3.1), (1.1, -0.6, 10.9)]
    outside = [(11.1, -20, 5), (10, -21.6, 5), (10, -20, 2.9), (0.9, -2, 9), (2, -0.4, 9), (2, -2, 11.1)]
    points = torch.tensor([*inside, *outside], dtype=torch.float64)
    assert ct.holds(points).tolist() == [True] * len(inside) + [False] * len(outside)
