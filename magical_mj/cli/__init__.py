"""The command `magical-mj`; one module for each group of subcommands. Nothing in the library imports this package."""

from __future__ import annotations

from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code: 0, or 2 for wrong use, 1 for a failure, 130 after Ctrl-C."""
    try:
        from magical_mj.cli.app import run
    except KeyboardInterrupt:  # while the command's modules are loaded; importing the package came before
        return 130
    return run(arguments)
