"""The command-line application: subcommands that are imported on demand, their help, and error messages."""

from __future__ import annotations

import io
import shutil
import signal
import sys
import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Final

import typer
from typer import Option
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from magical_mj._version import __version__
from magical_mj.utils.errors import MagicalError, SettingsError
from magical_mj.utils.imports import announced, imported, resolve_installed

COMMANDS: Final = {
    "list": (
        "magical_mj.cli.environments:list_environments",
        "List the environments, with their horizons and what varies in them.",
    ),
    "view": ("magical_mj.cli.environments:view", "Draw the initial scene of one environment or of all."),
    "rollout": (
        "magical_mj.cli.evaluate:rollout",
        "Play some episodes with a policy, print the scores, and make a video.",
    ),
    "evaluate": ("magical_mj.cli.evaluate:evaluate", "Evaluate policies in the test scenes."),
    "report": (
        "magical_mj.cli.results:make_report",
        "Write a report of one or several evaluations: tables, figures and videos.",
    ),
    "compare": (
        "magical_mj.cli.results:make_comparison",
        "Compare two policies on the scenes that both have played.",
    ),
    "demos": ("magical_mj.cli.demos:app", "Make, import, check, show and export demonstrations."),
    "play": ("magical_mj.cli.play:play", "Drive the robot yourself in a window, and record demonstrations."),
    "export": ("magical_mj.cli.environments:export", "Write a scene as a self-contained MJCF model."),
    "doctor": ("magical_mj.cli.doctor:doctor", "Show installed versions, and which renderers work."),
    "demo": ("magical_mj.cli.evaluate:demo", "Evaluate the built-in agents in all environments, and write the report."),
}
"""Command -> (its function or `typer.Typer` as "module:object", its summary).

The modules are imported on demand, because that is slow. Other packages announce such a mapping by an entry point of
`COMMAND_GROUP`. They may add commands to a group, as in "demos intents".
"""
COMMAND_GROUP: Final = "magical_mj.commands"
"""The entry-point group of further commands, such as ``learners = "magical_mj.learners.cli:COMMANDS"``."""
CLOSED_PIPE: Final = 141
"""The exit code if the output is closed before the help is complete. Shells report the same for commands in pipes."""
INTERRUPTED: Final = 130
LESS: Final = "use a smaller --episodes, --count, --jobs or --size"
WIDEST: Final = 100  # columns of help
NARROW: Final = 70  # columns; in narrower terminals, the help of an option is below its name


class Help(typer.Context.formatter_class):
    """Help as plain text, readable in terminals of 40 columns or more."""

    def __init__(self, indent_increment: int = 2, width: int | None = None, max_width: int | None = None) -> None:
        super().__init__(indent_increment, width or min(shutil.get_terminal_size().columns, WIDEST), max_width)

    def write_dl(self, rows: Sequence[tuple[str, str]], col_max: int = 30, col_spacing: int = 2) -> None:
        """Writes options and their help in two columns, or in narrow terminals one below the other."""
        super().write_dl(rows, col_max if self.width >= NARROW else 2, col_spacing)


class Context(typer.Context):
    """The context of a command with `Help`."""

    formatter_class = Help


@cache
def further_commands() -> Mapping[str, Mapping[str, tuple[str, str]]]:
    """Name of an addition or a package -> its commands, as in `COMMANDS`. None replaces another one."""
    points = announced("set of commands", COMMAND_GROUP, (), str.isidentifier, 'mine = "package.module:COMMANDS"')
    known, found = set(COMMANDS), dict[str, Mapping[str, tuple[str, str]]]()
    for name, point in points.items():
        commands = imported("set of commands", name, point, SettingsError)
        found[name] = {command: facts for command, facts in commands.items() if command not in known}
        known |= commands.keys()
    return found


def all_commands() -> dict[str, tuple[str, str]]:
    """All commands, those of the core first. Those of groups have two words."""
    return COMMANDS | {name: facts for commands in further_commands().values() for name, facts in commands.items()}


class Command(TyperCommand):
    """A command whose help has a section for each panel of options: those without a panel come first."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Writes the arguments and the options."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
            panel = getattr(parameter, "rich_help_panel", None) or usual
            if record := parameter.get_help_record(ctx):
                sections.setdefault(panel, []).append(record)
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


class Group(TyperGroup):
    """The group of all subcommands of `magical-mj`."""

    context_class = Context

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        names = [name for name in all_commands() if " " not in name]
        self.commands: Any = dict.fromkeys(names)  # names without commands yet, for suggestions
        self.rich_markup_mode = None

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """The names of the commands, in the order of the help."""
        return list(self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """The command with this name. None if it does not exist."""
        if cmd_name in self.commands and self.commands[cmd_name] is None:
            command = resolve_installed(all_commands()[cmd_name][0])
            if not isinstance(command, typer.Typer):
                function, command = command, typer.Typer(add_completion=False)
                command.command(cmd_name, cls=Command)(function)
            for name, (reference, _) in all_commands().items():
                group, _, inner = name.partition(" ")
                if group == cmd_name and inner:
                    command.command(inner)(resolve_installed(reference))
            found = self.commands[cmd_name] = plain(get_command(command))
            found.name, found.short_help = cmd_name, all_commands()[cmd_name][1]
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Writes the commands with their summaries."""
        for title, commands in {"commands": COMMANDS, **further_commands()}.items():
            rows = [(name, summary) for name, (_, summary) in commands.items() if " " not in name]
            if rows:
                with formatter.section(title.capitalize()):
                    formatter.write_dl(rows)


def plain(command: Any) -> Any:
    """The command with all its subcommands, with plain help that fits the terminal."""
    command.context_class, command.rich_markup_mode = Context, None
    command.context_settings.setdefault("help_option_names", ["-h", "--help"])
    for inner in getattr(command, "commands", {}).values():
        inner.short_help = " ".join((inner.help or "").split("\n\n")[0].split())  # click would cut it off
        plain(inner)
    return command


app = typer.Typer(
    name="magical-mj",
    cls=Group,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def start(
    context: typer.Context, version: Annotated[bool, Option("--version", help="Print the version and exit.")] = False
) -> None:
    """The MAGICAL benchmark for robust imitation learning, on MuJoCo."""
    if version:
        typer.echo(f"magical-mj {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def run(arguments: Sequence[str] | None = None, commands: typer.Typer = app, name: str = "magical-mj") -> int:
    """Runs an application, by default with this process's arguments, and returns its exit code.

    An expected error is printed as one line on stderr.
    """
    warnings.filterwarnings("ignore", module="glfw")  # our own error explains a missing display better
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # characters that a terminal cannot show become question marks
    try:
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # set by `magical_mj.cli.main` during imports
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return commands(args=arguments, prog_name=name, standalone_mode=False) or 0
    except (typer.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except SystemExit as ending:  # typer raises it if the pipe is closed while it prints
        if not isinstance(ending.__context__, BrokenPipeError):
            raise
        return CLOSED_PIPE
    except Exception as error:
        message, code = _explained(error, name)
        if message is None and _interrupted(error):
            return INTERRUPTED
        if message is None:
            raise
        from magical_mj.cli.console import complain  # imported late: help does not need it

        complain(message)
        return code


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error. A compiled module that is being loaded may turn it into its own error."""
    return isinstance(error, KeyboardInterrupt) or (
        error is not None and _interrupted(error.__cause__ or error.__context__)
    )


def _explained(error: Exception, name: str) -> tuple[str | None, int]:
    """A line for an expected error, and the exit code. The line is None for a defect of this package."""
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
            return f"not enough memory: {LESS}", 1
    mujoco = sys.modules.get("mujoco")  # not imported here: that may fail without OpenGL
    if mujoco is not None and isinstance(error, mujoco.FatalError):
        return f"MuJoCo has stopped ({error}); if memory ran out: {LESS}", 1
    return None, 1
