"""Calls with a time limit, which may be made in any thread."""

from __future__ import annotations

import ctypes
import queue
import threading
import weakref
from collections.abc import Callable
from typing import Any, Final, TypeVar

T = TypeVar("T")

Calls = queue.SimpleQueue[Callable[[], Any] | None]
Results = queue.SimpleQueue[tuple[Any, BaseException | None]]

GRACE: Final = 1.0
"""Seconds that a call has to end after it was stopped."""


class TimeLimitError(Exception):
    """A call took too long."""


class _Stop(BaseException):
    """Raised inside a call that took too long; not an `Exception`, so that handlers in the call do not catch it."""


class TimeLimitedCaller:
    """A thread that makes calls one after another, with a time limit.

    An alarm signal would need no thread, but works only in the main thread, which cluster workers may not use. A call
    that runs Python code is stopped; one that is stuck outside Python is abandoned.

    Attributes:
        abandoned: whether a call may still be running whose result nobody waits for: then this object must not be used
            again.
    """

    def __init__(self) -> None:
        self.abandoned = False
        self._calls: Calls = queue.SimpleQueue()
        self._results: Results = queue.SimpleQueue()
        queues = self._calls, self._results
        self._thread = threading.Thread(target=_work, args=queues, daemon=True, name="magical_mj episodes")
        self._thread.start()
        weakref.finalize(self, self._calls.put, None)  # nobody will call any more

    def call(self, function: Callable[[], T], seconds: float | None) -> T:
        """Returns or raises what the function returns or raises.

        Raises:
            TimeLimitError: if it takes longer than `seconds`; None means no limit.
        """
        self._calls.put(function)
        try:
            result, error = self._results.get(timeout=seconds)
        except queue.Empty:
            self._stop()
            raise TimeLimitError(f"no end within {seconds:g} s") from None
        except BaseException:  # Ctrl-C, or a signal's handler raised something
            self._stop()
            raise
        if error is not None:
            raise error
        return result

    def _stop(self) -> None:
        self.abandoned = True
        ident = self._thread.ident or 0
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(ident), ctypes.py_object(_Stop))
        self._thread.join(GRACE)


def _work(calls: Calls, results: Results) -> None:
    """What the thread does. It does not hold its caller, so that both end when nobody holds that any more."""
    while _answer(calls, results):
        pass


def _answer(calls: Calls, results: Results) -> bool:
    """Makes one call, and keeps nothing of it; whether another one may come."""
    try:
        function = calls.get()
        if function is None:
            return False
        result = function(), None
    except _Stop:
        return False
    except BaseException as error:  # noqa: BLE001 the caller gets it
        result = None, error
    results.put(result)
    return True
