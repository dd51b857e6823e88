"""The application: its subcommands, each loaded when it is needed, their help, and how errors are shown."""

from __future__ import annotations

import ast
import io
import shutil
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from magical_mj._version import __version__
from magical_mj.utils.errors import MagicalError
from magical_mj.utils.imports import command_line

PLACES: Final = {
    "list": "magical_mj.cli.environments:list_environments",
    "view": "magical_mj.cli.environments:view",
    "rollout": "magical_mj.cli.evaluate:rollout",
    "evaluate": "magical_mj.cli.evaluate:evaluate",
    "report": "magical_mj.cli.results:make_report",
    "compare": "magical_mj.cli.results:make_comparison",
    "verify": "magical_mj.cli.leaderboard:verify_folder",
    "submit": "magical_mj.cli.leaderboard:make_entry",
    "leaderboard": "magical_mj.cli.leaderboard:make_leaderboard",
    "demos": "magical_mj.cli.demos:app",
    "play": "magical_mj.cli.play:play",
    "export": "magical_mj.cli.environments:export",
    "doctor": "magical_mj.cli.doctor:doctor",
    "demo": "magical_mj.cli.evaluate:demo",
    "train": "magical_mj.cli.train:train",
    "experiment": "magical_mj.cli.train:experiment",
}
"""Command -> where its function is, or a `typer.Typer` with subcommands."""
CLOSED_PIPE: Final = 141
"""The exit code where the reader of the output has seen enough before the help was printed; as of shells' commands."""
INTERRUPTED: Final = 130
LESS: Final = "ask for fewer or smaller things at once, such as --episodes, --envs, --count, --jobs or --size"
WIDEST: Final = 100  # columns of help
NARROW: Final = 70  # columns below which the help of an option stands in the lines below it


class Help(typer.Context.formatter_class):
    """Help as plain text, which is readable from 40 columns on."""

    def __init__(self, indent_increment: int = 2, width: int | None = None, max_width: int | None = None) -> None:
        super().__init__(indent_increment, width or min(shutil.get_terminal_size().columns, WIDEST), max_width)

    def write_dl(self, rows: Sequence[tuple[str, str]], col_max: int = 30, col_spacing: int = 2) -> None:
        """Writes options and their help in two columns, or one below the other."""
        super().write_dl(rows, col_max if self.width >= NARROW else 2, col_spacing)


class Context(typer.Context):
    """The context of a command with `Help`."""

    formatter_class = Help


class Commands(Mapping[str, TyperCommand | TyperGroup]):
    """The subcommands by name; each is loaded when it is asked for."""

    def __init__(self) -> None:
        self._loaded: dict[str, TyperCommand | TyperGroup] = {}

    def __getitem__(self, name: str) -> TyperCommand | TyperGroup:
        if name not in self._loaded:
            module, _, attribute = PLACES[name].partition(":")
            command = getattr(import_module(module), attribute)
            if not isinstance(command, typer.Typer):
                function, command = command, typer.Typer(add_completion=False)
                command.command(name)(function)
            self._loaded[name] = plain(get_command(command))
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(PLACES)

    def __len__(self) -> int:
        return len(PLACES)


def summary(name: str) -> str:
    """The first paragraph of a command's docstring. Its module is not imported for that, which would take a while."""
    module, _, attribute = PLACES[name].partition(":")
    spec = find_spec(module)
    tree = ast.parse(Path((spec and spec.origin) or "").read_text(encoding="utf-8"))
    functions = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == attribute)
    docstring = next((ast.get_docstring(node) for node in functions), ast.get_docstring(tree)) or ""
    text = " ".join(docstring.split("\n\n")[0].rpartition("`: ")[2].split())  # of a module, after its command
    return text[:1].upper() + text[1:]


def plain(command: Any) -> Any:
    """The command with all its subcommands, with plain help that fits the terminal."""
    command.context_class, command.rich_markup_mode = Context, None
    command.context_settings.setdefault("help_option_names", ["-h", "--help"])
    for inner in getattr(command, "commands", {}).values():
        inner.short_help = " ".join((inner.help or "").split("\n\n")[0].split())  # else it is cut off
        plain(inner)
    return command


class Group(TyperGroup):
    """`magical-mj` itself."""

    context_class = Context

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: Any = Commands()
        self.rich_markup_mode = None

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Their names, in the order of the help."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Writes the commands with their summaries."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary(name)) for name in self.commands])


app = typer.Typer(
    name="magical-mj",
    cls=Group,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def start(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """The MAGICAL benchmark for robust imitation learning, on MuJoCo."""
    if version:
        typer.echo(f"magical-mj {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def run(arguments: Sequence[str] | None = None, commands: typer.Typer = app, name: str = "magical-mj") -> int:
    """Run the application; an expected error becomes one line on stderr and an exit code.

    Args:
        arguments: the words of the command line; None: those of this process.
        commands: the application.
        name: how it was called.
    """
    warnings.filterwarnings("ignore", module="glfw")  # our own error explains a missing display better
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # characters that a terminal cannot show become question marks
    try:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # while the package was imported: see its first lines
            signal.signal(signal.SIGINT, signal.default_int_handler)
        with command_line(sys.argv[1:] if arguments is None else arguments):
            return commands(args=arguments, prog_name=name, standalone_mode=False) or 0
    except (typer.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except SystemExit as ending:  # what typer makes of a closed pipe while it prints itself
        if not isinstance(ending.__context__, BrokenPipeError):
            raise
        return CLOSED_PIPE
    except Exception as error:
        message, code = _explained(error, name)
        if message is None:
            raise
        complain(message)
        return code


def _explained(error: Exception, name: str) -> tuple[str | None, int]:
    """One line for an expected error, and the exit code; None for a defect of this package."""
    match error:
        case typer.TyperException():
            context = getattr(error, "ctx", None)
            command = context.command_path if context else name
            message = error.format_message().replace("Value error, ", "").rstrip(".")
            return f"{message}; see {command} --help", error.exit_code
        case MagicalError():
            return str(error), 2 if isinstance(error, ValueError) else 1
        case OSError():
            return f"{error.filename}: {error.strerror}" if error.filename else str(error), 1
        case MemoryError():
            return f"the memory is not enough: {LESS}", 1
    mujoco = sys.modules.get("mujoco")  # imported late: it may fail where there is no OpenGL
    if mujoco is not None and isinstance(error, mujoco.FatalError):
        return f"MuJoCo has stopped ({error}); if the memory is not enough: {LESS}", 1
    return None, 1


def complain(message: str) -> None:
    """One line on standard error."""
    from magical_mj.cli import console

    console.complain(message)
