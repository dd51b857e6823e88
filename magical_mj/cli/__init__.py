"""The command `magical-mj`; one module for each group of subcommands. Nothing in the library imports this package."""

from __future__ import annotations

import gc
import signal
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line. Returns the exit code: 0, or 2 for invalid usage, 1 for a failure, 130 after Ctrl-C.

    While a command is being imported, Ctrl-C kills the process with the signal, which shells report as 130.
    """
    if arguments is None:  # the process is its own
        gc.set_threshold(10_000)  # by default, a fifth of the time of importing PyTorch is a search for garbage
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
    from magical_mj.cli.app import run

    return run(arguments)
