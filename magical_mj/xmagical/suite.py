"""The suite x-magical: its tasks, Gymnasium ids, expert and state vector.

The ids are ``magical_mj/<Task>-<Body>-<State|Pixels>-<Allo|Ego>-<Demo|TestX>-v0``; see `suite_id`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.scene.bodies import BODIES
from magical_mj.tasks.spec import TaskSpec
from magical_mj.xmagical.sweep_to_top import SPEC, state_vector

if TYPE_CHECKING:
    from magical_mj.engine import Engine

KINDS: Final = tuple(itertools.product(("State", "Pixels"), ("Allo", "Ego")))
"""The kinds of observations: what is observed, and the view of pictures."""


def suite_id(
    body: str, variant: str = "Demo", observation: str = "State", view: str = "Allo", task: str = SPEC.name
) -> str:
    """The id of a task with one of x-magical's bodies. The arguments are those of `magical_mj.xmagical.envs`."""
    test = variant if variant == "Demo" else f"Test{variant.replace('Colour', 'Color')}"
    return f"magical_mj/{task}-{body.capitalize()}-{observation}-{view}-{test}-v0"


class XMagical:
    """See `magical_mj.tasks.suites.Suite`."""

    tasks: Mapping[str, TaskSpec] = MappingProxyType({SPEC.name: SPEC})

    def register(self) -> None:
        """Registers the 96 ids of SweepToTop, and the ids of all other tasks with the suite's bodies."""
        import gymnasium  # imported late, like all of the following: tasks are pure
        from gymnasium.envs.registration import EnvSpec

        from magical_mj.envs.registration import AT_THE_END
        from magical_mj.tasks import KNOWN

        for spec, body, (observation, view) in itertools.product(KNOWN.values(), BODIES, KINDS):
            own = spec.name in self.tasks
            for variant in spec.variants:
                id_ = suite_id(body, variant, observation, view, spec.name)
                kwargs = {"body": body, "variant": variant, "observation": observation, "view": view}
                gymnasium.registry[id_] = EnvSpec(
                    id_,
                    entry_point=f"magical_mj.xmagical.envs:{'XMagicalEnv' if own else 'SpeedsEnv'}",
                    vector_entry_point=f"magical_mj.xmagical.envs:make_{'suite' if own else 'speed'}_vector",
                    kwargs=kwargs if own else {"task": spec.name, **kwargs},
                    max_episode_steps=spec.horizon("paper", body),
                    additional_wrappers=AT_THE_END,
                )

    def ids(self, task: str, variant: str) -> list[str]:
        """The ids of the task in this variant."""
        return [suite_id(body, variant, *kind, task) for body in BODIES for kind in KINDS]

    def state_id(self, task: str, variant: str, body: str) -> str:
        """The id of the environment with states as observations."""
        return suite_id(body, variant, task=task)

    def state(self, scene: Scene) -> NDArray[np.float32]:
        """The state vector of its environments."""
        return state_vector(scene)

    def expert(self, engine: Engine, seed: int) -> Callable[[], Any]:
        """The scripted expert."""
        from magical_mj.xmagical.expert import Sweeper

        return Sweeper(engine, seed)


SUITE: Final = XMagical()
