"""How alike two images are: higher is better. Many moving images against one fixed image at a time."""

from regtorch.similarity.gc import gradient_correlation, gradient_correlation_image
from regtorch.similarity.gi import gradient_information
from regtorch.similarity.ncc import normalized_cross_correlation
from regtorch.similarity.nmi import normalized_mutual_information

__all__ = [
    "gradient_correlation",
    "gradient_correlation_image",
    "gradient_information",
    "normalized_cross_correlation",
    "normalized_mutual_information",
]
