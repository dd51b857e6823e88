"""Policies that fail: which errors are a policy's, and one line about each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from magical_mj.utils.errors import RenderingError, TaskError

REASON_LENGTH: Final = 300


class PolicyError(Exception):
    """An error that a policy has raised."""


@contextmanager
def policy_errors() -> Iterator[None]:
    """Where errors are failures of the policy, unless they say that they are not."""
    try:
        yield
    except (RenderingError, TaskError):
        raise
    except (Exception, SystemExit) as error:  # a policy may raise anything
        raise PolicyError(reason(error)) from error


def simulation_failure(error: Exception) -> str:
    """One line about a simulation that a policy's actions made unstable; raises any other error again."""
    from dm_control.rl.control import PhysicsError  # imported late: it loads the simulator

    if not isinstance(error, PhysicsError | FloatingPointError):
        raise error
    return reason(error)


def reason(error: BaseException) -> str:
    """One line about an error, which can be encoded: Python shows bytes of file names as characters that cannot."""
    try:
        said = str(error)
    except Exception:  # noqa: BLE001 a policy's exceptions may be broken, too
        said = "an error without a message"
    text = " ".join(f"{type(error).__name__}: {said}".split())
    return text.encode(errors="backslashreplace").decode()[:REASON_LENGTH]
