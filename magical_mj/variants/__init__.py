"""Variants: functions from the demo scene to a varied scene. Which axes each variant draws, and how."""

from magical_mj.variants.rules import (
    VARIANTS,
    Axis,
    VariationRules,
    check_seed,
    variants_of,
    varied_axes,
    vary,
)

__all__ = [
    "VARIANTS",
    "Axis",
    "VariationRules",
    "check_seed",
    "variants_of",
    "varied_axes",
    "vary",
]
