"""Variants: functions from the demo scene to a varied scene. Which axes each variant draws, and how."""

from magical_mj.variants.rules import (
    AXES,
    VARIANTS,
    Axis,
    AxisRule,
    VariationRules,
    supported_axes,
    variants_of,
    varied_axes,
)
from magical_mj.variants.vary import check_seed, vary

__all__ = [
    "AXES",
    "VARIANTS",
    "Axis",
    "AxisRule",
    "VariationRules",
    "check_seed",
    "supported_axes",
    "variants_of",
    "varied_axes",
    "vary",
]
