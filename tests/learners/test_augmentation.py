"""What the augmentations do to pictures: their bounds, and what they leave alone."""

from __future__ import annotations

import math
from typing import get_args, get_type_hints

import pytest
import torch
from kornia.color import lab_to_rgb, rgb_to_lab
from torch import Tensor

from magical_mj.learners.augmentation import Augmentation, move, recolour
from magical_mj.learners.settings import AUGMENTATIONS, TrainingSettings

HEIGHT, WIDTH = 32, 48


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def only(*parts: str) -> Augmentation:
    augmentation = Augmentation()
    augmentation.parts = parts
    return augmentation


def random_stacks(count: int = 3, frames: int = 4) -> Tensor:
    return torch.rand((count, 3 * frames, HEIGHT, WIDTH), generator=seeded(7))


def blob(x: float, y: float) -> Tensor:
    """A soft white spot `x` to the right of the centre and `y` below it, of shape (1, 3, height, width)."""
    rows = torch.arange(HEIGHT)[:, None] - (HEIGHT - 1) / 2 - y
    columns = torch.arange(WIDTH)[None, :] - (WIDTH - 1) / 2 - x
    return torch.exp(-(rows**2 + columns**2) / 4).expand(1, 3, -1, -1)


def centres(weights: Tensor) -> tuple[Tensor, Tensor]:
    """The centres of mass of pictures (n, height, width), to the right of their middle and below it."""
    weights = weights / weights.sum((1, 2), keepdim=True)
    columns = torch.arange(weights.shape[2]) - (weights.shape[2] - 1) / 2
    rows = torch.arange(weights.shape[1]) - (weights.shape[1] - 1) / 2
    return (weights.sum(1) * columns).sum(1), (weights.sum(2) * rows).sum(1)


def plain(red: float, green: float, blue: float, count: int = 1) -> Tensor:
    return torch.tensor([red, green, blue])[None, :, None, None].repeat(count, 1, 4, 4)


def lab_of(stacks: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Luminance, chroma and hue of plain pictures, one each."""
    light, a, b = rgb_to_lab(stacks)[:, :, 0, 0].unbind(1)
    return light, torch.hypot(a, b), torch.atan2(b, a)


def test_frames_of_a_stack_are_changed_alike_and_stacks_differently() -> None:
    frame = random_stacks(1, frames=1)
    result = only("translation", "rotation", "colour")(frame.repeat(5, 4, 1, 1), seeded())
    frames = result.unflatten(1, (4, 3))
    assert torch.equal(frames, frames[:, :1].expand_as(frames))
    for first in range(5):
        for second in range(first):
            assert (frames[first] - frames[second]).abs().mean() > 0.01


def test_translation_reaches_its_bounds_and_keeps_them() -> None:
    result = only("translation")(blob(0, 0).repeat(1000, 1, 1, 1), seeded())
    for shift, side in zip(centres(result[:, 0]), (WIDTH, HEIGHT), strict=True):
        share = shift / side
        assert share.abs().max() <= 0.05 + 1e-4
        assert share.max() > 0.049
        assert share.min() < -0.049
        assert share.std() == pytest.approx(0.05 / math.sqrt(3), rel=0.05)  # uniform


def test_rotation_reaches_its_bounds_and_keeps_them() -> None:
    result = only("rotation")(blob(12, 0).repeat(1000, 1, 1, 1), seeded())
    right, down = centres(result[:, 0])
    degrees = torch.rad2deg(torch.atan2(down, right))
    assert degrees.abs().max() <= 5 + 0.05
    assert degrees.max() > 4.9
    assert degrees.min() < -4.9
    assert degrees.std() == pytest.approx(5 / math.sqrt(3), rel=0.05)
    torch.testing.assert_close(torch.hypot(right, down), torch.full((1000,), 12.0), atol=0.02, rtol=0)


def test_move_goes_where_it_says() -> None:
    """Clockwise about the centre, then to the right and down."""
    degrees = torch.tensor([5.0])
    right, down = centres(move(blob(10, -4), torch.tensor([[2.5, -1.25]]), degrees)[:, 0])
    cosine, sine = math.cos(math.radians(5)), math.sin(math.radians(5))
    assert right.item() == pytest.approx(10 * cosine + 4 * sine + 2.5, abs=0.02)
    assert down.item() == pytest.approx(10 * sine - 4 * cosine - 1.25, abs=0.02)


def test_translated_pictures_are_padded_by_reflection() -> None:
    stacks = random_stacks(1)
    result = move(stacks, torch.tensor([[2.0, -1.0]]), torch.zeros(1))
    torch.testing.assert_close(result[..., :-1, 2:], stacks[..., 1:, :-2], atol=1e-4, rtol=0)
    torch.testing.assert_close(result[..., :-1, 0], stacks[..., 1:, 2], atol=1e-4, rtol=0)
    torch.testing.assert_close(result[..., -1, 2:], stacks[..., -2, :-2], atol=1e-4, rtol=0)
    white = torch.ones(50, 3, HEIGHT, WIDTH)
    assert only("translation", "rotation")(white, seeded()).min() > 1 - 1e-5


@pytest.mark.parametrize("grey", [0.02, 0.9])
def test_luminance_reaches_its_bounds_and_keeps_them(grey: float) -> None:
    before, _, _ = lab_of(plain(grey, grey, grey).double())
    after, chroma, _ = lab_of(only("colour")(plain(grey, grey, grey, 1000).double(), seeded()))
    ratio = after / before
    assert (ratio - 1).abs().max() <= 0.01 + 1e-4
    assert ratio.max() > 1.0098
    assert ratio.min() < 0.9902
    assert chroma.max() < 0.02  # greys stay grey


@pytest.mark.parametrize("colour", [(0.6, 0.4, 0.3), (0.35, 0.4, 0.6)])
def test_hue_reaches_its_bounds_and_keeps_them(colour: tuple[float, float, float]) -> None:
    light, chroma, hue = lab_of(plain(*colour).double())
    new_light, new_chroma, new_hue = lab_of(only("colour")(plain(*colour, 1000).double(), seeded()))
    turn = torch.remainder(new_hue - hue + math.pi, 2 * math.pi) - math.pi
    assert turn.abs().max() <= 0.15 + 1e-3
    assert turn.max() > 0.148
    assert turn.min() < -0.148
    assert turn.std() == pytest.approx(0.15 / math.sqrt(3), rel=0.05)
    torch.testing.assert_close(new_chroma, chroma.expand(1000), atol=0.02, rtol=0)
    assert (new_light / light - 1).abs().max() <= 0.01 + 1e-4
    assert torch.corrcoef(torch.stack([turn, new_light]))[0, 1].abs() < 0.15  # drawn independently


def test_recolouring_agrees_with_kornia() -> None:
    """To a fifth of a grey level, over all of RGB with its faces, edges and corners, and dark colours."""
    steps = torch.cat([torch.linspace(0, 0.06, 7), torch.linspace(0.1, 1, 17)]).double()
    cube = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij")).reshape(1, 3, len(steps), -1)
    for factor, angle in [(1.0, 0.0), (0.99, 0.15), (1.01, -0.15), (1.01, 0.15)]:
        light, a, b = rgb_to_lab(cube).unbind(1)
        cosine, sine = math.cos(angle), math.sin(angle)
        expected = lab_to_rgb(torch.stack([light * factor, cosine * a - sine * b, sine * a + cosine * b], 1))
        result = recolour(cube.float(), torch.tensor([factor]), torch.tensor([angle]))
        assert (result - expected).abs().max() < 1 / 255 / 5


def test_noise_is_normal_and_independent() -> None:
    stacks = torch.full((4, 12, HEIGHT, WIDTH), 0.5)
    noise = only("noise")(stacks, seeded()).double() - 0.5
    assert noise.mean().abs() < 4 * 0.01 / math.sqrt(noise.numel())
    assert noise.std() == pytest.approx(0.01, rel=0.02)
    for deviations, share in [(1, 0.6827), (2, 0.9545), (3, 0.9973)]:
        assert (noise.abs() < 0.01 * deviations).double().mean() == pytest.approx(share, abs=0.005)
    for axis in range(4):  # neighbours along each axis: stacks, channels, rows and columns
        size = noise.shape[axis] - 1
        pairs = torch.stack([noise.narrow(axis, 0, size).flatten(), noise.narrow(axis, 1, size).flatten()])
        assert torch.corrcoef(pairs)[0, 1].abs() < 4 / math.sqrt(pairs.shape[1])


def test_the_sets_are_those_that_settings_allow() -> None:
    assert set(get_args(get_type_hints(TrainingSettings)["augment"])) == set(AUGMENTATIONS)


@pytest.mark.parametrize("preset", AUGMENTATIONS)
def test_the_result_is_like_the_input(preset: str) -> None:
    """Whatever its type and memory format, which change no value."""
    stacks = random_stacks().mul(1.5).sub(0.25).clamp(0, 1)
    first = Augmentation(preset)(stacks, seeded())
    for dtype in (torch.float32, torch.float64):
        for memory_format in (torch.contiguous_format, torch.channels_last):
            inputs = stacks.to(dtype).contiguous(memory_format=memory_format)
            result = Augmentation(preset)(inputs, seeded())
            assert (result.shape, result.dtype, result.stride()) == (stacks.shape, dtype, inputs.stride())
            assert 0 <= result.min() <= result.max() <= 1
            assert torch.equal(inputs, stacks.to(dtype))
            torch.testing.assert_close(result.float(), first, atol=1e-4, rtol=0)


def test_all_randomness_comes_from_the_generator() -> None:
    stacks = random_stacks()
    state = torch.get_rng_state()
    first, second = (Augmentation()(stacks, seeded(3)) for _ in range(2))
    assert torch.equal(first, second)
    assert torch.equal(torch.get_rng_state(), state)
    assert not torch.equal(first, Augmentation()(stacks, seeded(4)))
    generator = seeded(3)
    assert torch.equal(Augmentation()(stacks, generator), first)
    assert not torch.equal(Augmentation()(stacks, generator), first)


def test_without_translation_and_rotation_nothing_moves() -> None:
    stacks = torch.full((10, 3, HEIGHT, WIDTH), 0.2)
    stacks[:, :, 5:20, 7:30] = 0.8
    result = Augmentation("no-trans-rot")(stacks, seeded())
    assert torch.equal(result > 0.5, stacks > 0.5)
    assert not torch.equal(result, stacks)


def test_none_changes_nothing() -> None:
    stacks, generator = random_stacks(), seeded()
    assert Augmentation("none")(stacks, generator) is stacks
    assert torch.equal(generator.get_state(), seeded().get_state())


def test_recolouring_a_few_at_a_time_is_the_same_to_the_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    stacks = random_stacks(9)
    light, hue = 1 + torch.linspace(-0.01, 0.01, 9), torch.linspace(-0.15, 0.15, 9)
    results = []
    for chunk in (1, 4, 9):
        monkeypatch.setattr("magical_mj.learners.augmentation.CHUNK", chunk)
        results.append(recolour(stacks, light, hue))
    assert torch.equal(results[0], results[2])
    assert torch.equal(results[1], results[2])
