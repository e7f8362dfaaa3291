"""The nine parameters, views, projection matrices and cone-beam rays."""

from regtorch.geometry.detector import Detector
from regtorch.geometry.parameters import (
    ETA,
    KEYS,
    NAMES,
    PHI,
    THETA,
    X_OBJ,
    X_S,
    Y_OBJ,
    Y_S,
    Z_OBJ,
    Z_S,
    free_indices,
    parameters_from_dict,
    parameters_to_dict,
)
from regtorch.geometry.projection import (
    parameters_from_matrix,
    pixel_from_patient,
    pixel_from_world,
    project,
    world_from_ct,
)
from regtorch.geometry.rays import cone_beam_rays, ray_jacobian
from regtorch.geometry.rotation import euler_from_rotation, rotation_from_euler
from regtorch.geometry.views import VIEWS, same_view, world_from_patient_axes

__all__ = [
    "ETA",
    "KEYS",
    "NAMES",
    "PHI",
    "THETA",
    "VIEWS",
    "X_OBJ",
    "X_S",
    "Y_OBJ",
    "Y_S",
    "Z_OBJ",
    "Z_S",
    "Detector",
    "cone_beam_rays",
    "euler_from_rotation",
    "free_indices",
    "parameters_from_dict",
    "parameters_from_matrix",
    "parameters_to_dict",
    "pixel_from_patient",
    "pixel_from_world",
    "project",
    "ray_jacobian",
    "rotation_from_euler",
    "same_view",
    "world_from_ct",
    "world_from_patient_axes",
]
