"""What the state vector and the views contain."""

from magical_mj.scene.state_vector import (
    CAMERAS,
    MAX_BLOCKS,
    MAX_REGIONS,
    OBSERVATIONS,
    SEGMENTATIONS,
    SOLID_VIEW,
    START_NAMES,
    STATE_NAMES,
    VIEWS,
    StateEncoder,
)

__all__ = [
    "CAMERAS",
    "MAX_BLOCKS",
    "MAX_REGIONS",
    "OBSERVATIONS",
    "SEGMENTATIONS",
    "SOLID_VIEW",
    "START_NAMES",
    "STATE_NAMES",
    "VIEWS",
    "StateEncoder",
]
