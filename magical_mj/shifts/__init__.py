"""Shifts: changes with strengths from 0 to 5 that can be applied to any environment, in addition to its variant."""

from __future__ import annotations

from magical_mj.shifts.registry import SHIFTS, expand_shifts, parse_shifts, shift_class, shift_label
from magical_mj.shifts.shift import Factor, Frame, Picture, Shift

__all__ = [
    "SHIFTS",
    "Factor",
    "Frame",
    "Picture",
    "Shift",
    "expand_shifts",
    "parse_shifts",
    "shift_class",
    "shift_label",
]
