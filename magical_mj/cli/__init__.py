"""The command `magical-mj`; one module for each group of subcommands. Nothing in the library imports this package."""

from __future__ import annotations

import signal
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code: 0, or 2 for wrong use, 1 for a failure, 130 after Ctrl-C.

    While the modules of a command are imported, Ctrl-C ends the process by the signal, which shells show as 130.
    """
    if arguments is None and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from magical_mj.cli.app import run

    return run(arguments)
