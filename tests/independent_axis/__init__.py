"""A rotary axis, simulated with other equations than the product's: see `axis`."""

from tests.independent_axis.axis import MOTIONS, SIZES, Axis, Size

__all__ = ["MOTIONS", "SIZES", "Axis", "Size"]
