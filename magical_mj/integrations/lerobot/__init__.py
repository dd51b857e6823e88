"""The environments in LeRobot's commands, and LeRobot's checkpoints in this package's evaluation.

LeRobot's commands find this module by ``--env.discover_packages_path=magical_mj.integrations.lerobot``; the options
``--env.type=magical --env.task=FindDupe --env.variant=Layout`` then choose environments (comma lists make one suite
for each task). Observations are ``pixels`` (96 px pictures, height x width x channels, uint8; a dict of views with
``--env.views=both``), or with ``--env.views=state`` ``environment_state``; and ``agent_pos``: three zeros, or with
``--env.fingers=true`` the angles of the two fingers. Actions are vectors (drive, turn, grip), and the
score is the reward of the last step. ``--seed=0 --eval.n_episodes=100`` plays the scenes of seeds 0 to 99.
"""

from __future__ import annotations

from magical_mj.integrations.lerobot.environments import LeRobotEnv, MagicalConfig
from magical_mj.integrations.lerobot.policy import LeRobotPolicy, load_checkpoint

__all__ = ["LeRobotEnv", "LeRobotPolicy", "MagicalConfig", "load_checkpoint"]
