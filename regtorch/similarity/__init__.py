"""How alike two images are: higher is better. Many moving images against one fixed image at a time."""

from regtorch.similarity.gradient_correlation import gradient_correlation, gradient_correlation_image
from regtorch.similarity.gradient_information import gradient_information
from regtorch.similarity.normalized_cross_correlation import normalized_cross_correlation
from regtorch.similarity.normalized_mutual_information import normalized_mutual_information

__all__ = [
    "gradient_correlation",
    "gradient_correlation_image",
    "gradient_information",
    "normalized_cross_correlation",
    "normalized_mutual_information",
]
