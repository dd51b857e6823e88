"""The original's world, rebuilt on its own engine: does it follow the recordings? Needs pymunk 5.6."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rollouts import probe_poses, probe_scene, recordings

pytest.importorskip("pymunk", reason="the original's engine is not installed")
from original import Original, nudged

PROBES = recordings(Path(__file__).parent / "data" / "probes.npz")


@pytest.mark.parametrize("name", ["drive/hold_action_02", "drive/hold_action_12", "push/pentagon_offset00_angle4"])
def test_free_roll_outs_are_the_recorded_ones(name: str) -> None:
    poses, fingers = Original(probe_scene(PROBES[name])).roll(PROBES[name]["actions"].tolist())
    np.testing.assert_allclose(poses, probe_poses(PROBES[name]), atol=5e-6)
    np.testing.assert_allclose(fingers, PROBES[name]["fingers"], atol=5e-6)


@pytest.mark.parametrize("shape", ["square", "circle", "pentagon", "star"])
def test_a_gripped_block_slows_the_robot_as_recorded(shape: str) -> None:
    """Backwards to less than 0.6 units/s, which hinges would reach; chance decides how much less."""
    case = PROBES[f"grip/{shape}_forward_back"]
    pins, hinges = (Original(probe_scene(case), hinged=hinged) for hinged in (False, True))
    tracks = probe_poses(case), *(world.roll(case["actions"].tolist())[0] for world in (pins, hinges))
    recorded, pinned, hinged = (np.diff(track[17:20, 0, 1]).mean() * 8 for track in tracks)
    assert recorded > -0.57
    assert pinned == pytest.approx(recorded, abs=0.05)
    assert hinged == pytest.approx(-0.6, abs=0.02)


def test_nudges_are_small_and_seed_0_is_none() -> None:
    scene = probe_scene(PROBES["spin/star"])
    assert nudged(scene, 0) == scene
    assert 0 < abs(nudged(scene, 1).robot.x - scene.robot.x) < 1e-6
