"""Variants: a scene in, a scene out. Which axes each one draws anew, and how."""

from magical_mj.variants.axes import AXES, VARIANTS, Axis, supported_axes, variants_of, varied_axes
from magical_mj.variants.vary import check_seed, vary

__all__ = ["AXES", "VARIANTS", "Axis", "check_seed", "supported_axes", "variants_of", "varied_axes", "vary"]
