"""A time limit for calls that may never return."""

from __future__ import annotations

import ctypes
import queue
import threading
from collections.abc import Callable
from typing import Any, Final, TypeVar

T = TypeVar("T")

GRACE: Final = 1.0
"""Seconds that a call gets to end once it was told to."""


class TimeLimitError(Exception):
    """A call took too long."""


class _Stop(BaseException):
    """Thrown into a call that took too long; not an Exception, so that the call's own handlers let it pass."""


class Workbench:
    """A thread that makes calls one after another, so that its caller need not wait for ever.

    An alarm signal would need no thread, but works only in the main thread, which clusters do not give us. A call in
    Python code is stopped; one that is stuck outside of Python is left behind, asleep. After a `TimeLimitError` the
    bench is used up.
    """

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[Callable[[], Any]] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, daemon=True, name="magical_mj episodes")
        self._thread.start()

    def call(self, function: Callable[[], T], seconds: float | None) -> T:
        """What the function returns or raises.

        Raises:
            TimeLimitError: if it takes more than so many seconds; None is for ever.
        """
        self._calls.put(function)
        try:
            result, error = self._results.get(timeout=seconds)
        except queue.Empty:
            self._stop()
            raise TimeLimitError(f"no end within {seconds:g} s") from None
        if error is not None:
            raise error
        return result

    def _work(self) -> None:
        while True:
            try:
                result = self._calls.get()(), None
            except _Stop:
                return
            except BaseException as error:  # noqa: BLE001 the caller gets it
                result = None, error
            self._results.put(result)

    def _stop(self) -> None:
        ident = self._thread.ident or 0
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(ident), ctypes.py_object(_Stop))
        self._thread.join(GRACE)
