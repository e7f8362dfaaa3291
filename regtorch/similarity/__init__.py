"""Similarities of many moving images with one fixed image; higher is better."""

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
