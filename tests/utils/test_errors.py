"""The package's exceptions are also the built-in ones that callers and other libraries expect."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import pytest

import magical_mj
from magical_mj.intents import SETS
from magical_mj.learners import METHODS, load_policy, load_settings
from magical_mj.utils import errors
from magical_mj.utils.errors import MagicalError

STATES = "magical_mj/FixColour-Demo-State-v0"
MISSING = Path("nowhere") / "at" / "all"


def changed() -> magical_mj.Engine:
    engine = magical_mj.Engine("FixColour")
    engine.model.opt.timestep = 1e-3
    return engine


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        (lambda: gymnasium.make(STATES, frameskip=1), TypeError),
        (lambda: magical_mj.make_vec(STATES, 1, frameskip=1), TypeError),
        (lambda: magical_mj.load("FixColour", frameskip=1), TypeError),
        (lambda: magical_mj.Engine("FixColour", frameskip=1), TypeError),  # type: ignore[call-arg]
        (lambda: magical_mj.evaluate("noop", frameskip=1), TypeError),
        (lambda: load_settings("bc", "FixColour", frameskip=1), TypeError),
        (lambda: copy.deepcopy(changed()), TypeError),
        (lambda: pickle.dumps(changed()), TypeError),
        (lambda: load_policy(MISSING), FileNotFoundError),
        (lambda: magical_mj.evaluate(str(MISSING), tasks="FixColour"), FileNotFoundError),
        (lambda: magical_mj.evaluate("missing.onnx", tasks="FixColour"), FileNotFoundError),
        (lambda: magical_mj.demos.load("FixColour", MISSING), FileNotFoundError),
        (lambda: magical_mj.demos.read(MISSING), FileNotFoundError),
        (lambda: magical_mj.evaluate("no_such_module:policy", tasks="FixColour"), ImportError),
        (lambda: magical_mj.evaluate("math:no_such_name", tasks="FixColour"), ImportError),
        (lambda: METHODS["no such method"], KeyError),
        (lambda: SETS["no such set"], KeyError),
        (lambda: magical_mj.no_such_name, AttributeError),
        (lambda: gymnasium.make(STATES).get_wrapper_attr("no_such_name"), AttributeError),
        (lambda: magical_mj.sample_scene("FixColour", "Demo", -1), ValueError),
    ],
)
def test_a_wrong_call_raises_the_error_that_python_would(call: Callable[[], Any], kind: type[Exception]) -> None:
    with pytest.raises(kind) as raised:
        call()
    assert isinstance(raised.value, MagicalError) or type(raised.value) is kind
    assert len(str(raised.value)) > 10
    again = pickle.loads(pickle.dumps(raised.value))  # errors reach users from worker processes
    assert (type(again), str(again)) == (type(raised.value), str(raised.value))


def test_every_exception_survives_the_way_from_a_worker_process() -> None:
    """Also those that are made of something else than a message."""
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, MagicalError)]
    assert len(kinds) > 20
    for kind in kinds:
        error = kind("mine:SPEC", "a file") if kind is errors.UntrustedNameError else kind("what was wrong")
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again), vars(again)) == (kind, str(error), vars(error))
    assert str(errors.UntrustedNameError("mine:SPEC", "a file")).startswith("a file refers to mine:SPEC, and")


def test_an_unknown_argument_is_found_by_those_who_look_for_pythons_text() -> None:
    """TorchRL passes `frameskip`, and withdraws it if the message says so."""
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'frameskip'. There are: task, variant, .*"):
        gymnasium.make(STATES, frameskip=1)


def test_attributes_can_be_looked_for_at_any_time() -> None:
    """Debuggers and other libraries call `hasattr` and `getattr` on environments that are not reset yet."""
    for env in (magical_mj.MagicalEnv("FixColour", "Demo", "State"), magical_mj.make_vec(STATES, 1)):
        assert all(hasattr(env, name) for name in dir(env) if not name.startswith("_"))
        assert not hasattr(env, "no_such_name")
        env.close()
