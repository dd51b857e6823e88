import pytest

pytest.importorskip("mujoco_warp", reason='batched environments need MuJoCo Warp: pip install -e ".[gpu]"')
