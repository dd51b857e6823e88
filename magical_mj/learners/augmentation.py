"""The paper's augmentations (its appendix, "Default augmentation set"): of pictures, and their counterparts for states.

Pictures are first moved, then recoloured, and noise is added last, so that the interpolation does not smooth the noise.
The paper does not give an order.

Kornia moves the pictures. Colours are changed here: on CPUs, kornia's conversions take three times as long, more than
a step of the network.
"""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor

from magical_mj.learners.networks import pose_mask
from magical_mj.learners.settings import AUGMENTATIONS, TrainingSettings
from magical_mj.policies.interface import HISTORY

TRANSLATION: Final = 0.05  # bound of the uniform draws, as a share of the picture's width and height
ROTATION: Final = 5.0  # degrees
LUMINANCE: Final = 0.01  # the largest deviation of the factor from one
HUE: Final = 0.15  # radians in the plane of a and b
NOISE: Final = 0.01  # standard deviation, of values in [0, 1]; the paper's N(0, 0.01) may also mean the variance

STATE_TRANSLATION: Final = 0.02  # for states: bound of the uniform draws along each axis, in units
STATE_ROTATION: Final = 2.0  # for states: bound of the uniform draws, in degrees
STATE_NOISE: Final = 0.01  # standard deviation, in units and radians, of poses and finger angles of the present state
PAST_NOISE: Final = 0.2  # standard deviation of the same numbers in the earlier states
"""This noise is large, so that a policy cannot infer the last action from the latest movements and repeat it (de Haan
et al., 2019: "Causal Confusion in Imitation Learning"). On demonstrations this would be right for four of five
actions."""

CHUNK: Final = 4
"""Stacks that are recoloured at once on a CPU, so that they fit into its cache. This is twice as fast."""

# Linear sRGB to CIE XYZ (IEC 61966-2-1). Rows that add up to one give XYZ relative to the white point, so that greys
# have a = b = 0 exactly.
_XYZ = torch.tensor([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]).double()
_XYZ /= _XYZ.sum(1, keepdim=True)
# The cube roots of XYZ to L + 16, a and b (CIE 15).
_LAB = torch.tensor([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]]).double()
_ROOT_KNOT: Final = 6 / 29  # below this cube root, CIE 15 is linear
_ROOT_SLOPE: Final = 1 / (3 * _ROOT_KNOT**2)
_SRGB_KNOT: Final = 0.04045  # up to this value, sRGB is linear
# Linear values are multiplied by _SCALE, so that ((v + 0.055) / 1.055)^2.4 is (v + 0.055)^2.4 here.
_SCALE: Final = 1.055**2.4
_SRGB_SLOPE: Final = _SCALE / 12.92


class Augmentation:
    """Augments batches of frame stacks. `preset` is one of the `AUGMENTATIONS`."""

    def __init__(self, preset: str = "all") -> None:
        self.parts = AUGMENTATIONS[preset]

    @torch.no_grad()
    def __call__(self, stacks: Tensor, generator: torch.Generator, /) -> Tensor:
        """Returns an augmented copy of `stacks`. No gradients flow back to them.

        All frames of a stack are moved and recoloured equally, different stacks differently. The noise is independent.

        Args:
            stacks: RGB frames in [0, 1], float32 or float64, of shape (n, 3 * frames, height, width). Their memory
                format does not affect the values of the result.
            generator: source of all random numbers, which are drawn on its device.

        Returns:
            Stacks in [0, 1] of the same shape, type, device and memory format. If no augmentation is selected, it is
            `stacks` itself.
        """
        if not self.parts:
            return stacks
        # Unused values are drawn as well, so that a seed gives the same colours with and without translation and
        # rotation.
        draws = torch.rand((5, len(stacks)), generator=generator, device=generator.device, dtype=torch.float32)
        right, down, turn, light, hue = draws.mul_(2).sub_(1).to(stacks)
        pictures = stacks
        if "translation" in self.parts or "rotation" in self.parts:
            height, width = stacks.shape[-2:]
            shifts = torch.stack([right * width, down * height], 1) * TRANSLATION * ("translation" in self.parts)
            pictures = move(pictures, shifts, turn * ROTATION * ("rotation" in self.parts))
        if "colour" in self.parts:
            pictures = recolour(pictures, 1 + light * LUMINANCE, hue * HUE)
        if "noise" in self.parts:
            noise = torch.randn(stacks.shape, generator=generator, device=generator.device, dtype=torch.float32)
            pictures = torch.add(pictures, noise.to(stacks), alpha=NOISE)
        return torch.empty_like(stacks).copy_(pictures.clamp_(0, 1))


class StateAugmentation(Augmentation):
    """Changes histories of states at random.

    Translation and rotation of a picture correspond to a small change of the robot's pose, the same in all four states
    of a history. Pixel noise corresponds to noise of poses, drawn for each state, and larger in the earlier ones.
    Colours and shapes are categories in states and are not changed.
    """

    @torch.no_grad()
    def __call__(self, histories: Tensor, generator: torch.Generator, /) -> Tensor:
        """Returns changed copies of histories (n, HISTORY, names), or with a successor, (n, HISTORY + 1, names).

        If no augmentation is selected, `histories` itself is returned.
        """
        if not self.parts:
            return histories
        shifts = torch.rand((len(histories), 1, 3), generator=generator, device=generator.device)
        shifts = shifts.mul_(2).sub_(1).to(histories)
        shifts *= shifts.new_tensor([STATE_TRANSLATION, STATE_TRANSLATION, math.radians(STATE_ROTATION)])
        shifts *= shifts.new_tensor(["translation" in self.parts] * 2 + ["rotation" in self.parts])
        noise = torch.randn(histories.shape, generator=generator, device=generator.device).to(histories)
        sizes = noise.new_full((histories.shape[1], 1), PAST_NOISE)
        sizes[HISTORY - 1 :] = STATE_NOISE
        changed = histories + sizes * noise * pose_mask(histories)
        changed[..., :3] += shifts
        return changed


def augmentation(settings: TrainingSettings) -> Augmentation:
    """The augmentation of a run's observations."""
    return StateAugmentation(settings.augment) if settings.states else Augmentation(settings.augment)


def move(stacks: Tensor, shifts: Tensor, degrees: Tensor) -> Tensor:
    """Rotates pictures clockwise about their centres, then shifts them, with reflection padding.

    Args:
        stacks: shape (n, channels, height, width).
        shifts: pixels to the right and down, of shape (n, 2).
        degrees: shape (n,).
    """
    from kornia.geometry.transform import get_affine_matrix2d, warp_affine  # half a second, which states do not need

    height, width = stacks.shape[-2:]
    centres = shifts.new_tensor([(width - 1) / 2, (height - 1) / 2]).expand_as(shifts)
    matrices = get_affine_matrix2d(shifts, centres, torch.ones_like(shifts), degrees)[:, :2]
    return warp_affine(stacks, matrices, (height, width), padding_mode="reflection", align_corners=True)


def recolour(stacks: Tensor, luminance: Tensor, hue: Tensor) -> Tensor:
    """Scales the luminance L of CIELab and rotates its plane of a and b.

    L + 16, a and b are linear in the cube roots of XYZ. So the conversion to CIELab, the change and the conversion back
    are one matrix per stack, and L, a and b of the pixels need not be computed.

    Args:
        stacks: RGB pictures in [0, 1], of shape (n, 3 * frames, height, width).
        luminance: factors of L, of shape (n,).
        hue: radians, of shape (n,).

    Returns:
        Pictures in [0, 1] of the same shape. Colours outside RGB are clipped.
    """
    count = CHUNK if stacks.device.type == "cpu" else max(1, len(stacks))
    parts = zip(stacks.split(count), luminance.split(count), hue.split(count), strict=True)
    recoloured = torch.empty_like(stacks, memory_format=torch.contiguous_format)
    for part, result in zip(parts, recoloured.split(count), strict=True):
        result.copy_(_recoloured(*part))
    return recoloured


def _recoloured(stacks: Tensor, luminance: Tensor, hue: Tensor) -> Tensor:
    frames = stacks.shape[1] // 3
    change = torch.zeros((len(stacks), 3, 3), dtype=torch.float64, device=stacks.device)
    change[:, 0, 0] = luminance
    change[:, 1, 1] = change[:, 2, 2] = hue.cos()
    change[:, 2, 1] = hue.sin()
    change[:, 1, 2] = -hue.sin()
    to_lab, from_lab = _LAB.to(stacks.device), torch.linalg.inv(_LAB).to(stacks.device)
    matrices = (from_lab @ change @ to_lab).to(stacks).repeat_interleave(frames, 0)
    offsets = (16 / 116 * (1 - luminance)).repeat_interleave(frames)[:, None, None]  # the 16 of L + 16 is not scaled

    values = stacks.reshape(-1, 3, stacks.shape[-2] * stacks.shape[-1])  # frames x RGB x pixels
    # Each curve is linear below its knot and a power above, and the two meet there: f(v) = power(max(v, knot)) +
    # slope * min(v - knot, 0). This is exact, and much cheaper than a choice with torch.where.
    high = values.clamp(min=_SRGB_KNOT)
    low = values - high
    values = _power_(high.add_(0.055), 2.4).add_(low, alpha=_SRGB_SLOPE)
    values = (_XYZ / _SCALE).to(stacks) @ values
    high = values.clamp(min=_ROOT_KNOT**3)
    low = values.sub_(high)
    values = _power_(high, 1 / 3).add_(low, alpha=_ROOT_SLOPE)
    values = torch.baddbmm(offsets, matrices, values)
    high = values.clamp(min=_ROOT_KNOT)
    low = values.sub_(high)
    values = high.pow_(3).add_(low, alpha=1 / _ROOT_SLOPE)
    values = torch.linalg.inv(_XYZ / _SCALE).to(stacks) @ values
    high = values.clamp(min=_SRGB_KNOT * _SRGB_SLOPE)
    low = values.sub_(high)
    values = _power_(high, 1 / 2.4).sub_(0.055).add_(low, alpha=1 / _SRGB_SLOPE)
    return values.clamp_(0, 1).view(stacks.shape)


def _power_(values: Tensor, exponent: float) -> Tensor:
    """Raises positive `values` to the power in place, three times as fast as Tensor.pow_."""
    return values.log2_().mul_(exponent).exp2_()
