"""Variants: the axes that each one varies, and the functions that make its scenes from the demo scene."""

from magical_mj.variants.rules import (
    OTHER_VARIANTS,
    VARIANTS,
    Axis,
    VariationRules,
    check_seed,
    varied_axes,
    vary,
)

__all__ = ["OTHER_VARIANTS", "VARIANTS", "Axis", "VariationRules", "check_seed", "varied_axes", "vary"]
