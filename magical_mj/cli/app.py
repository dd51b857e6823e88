"""The application: its subcommands, and how errors are shown."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated, Final

import typer

import magical_mj
from magical_mj.cli import demo, demo_exports, demos, doctor, environments, evaluate, leaderboard, play, results, train
from magical_mj.cli.console import complain
from magical_mj.cli.doctor import NO_DM_CONTROL
from magical_mj.utils.errors import MagicalError
from magical_mj.utils.imports import command_line

CLOSED_PIPE: Final = 141
"""The exit code where the reader of the output has seen enough before the help was printed; as of shells' commands."""
LESS: Final = "ask for fewer or smaller things at once, such as --episodes, --envs, --count, --jobs or --size"

app = typer.Typer(
    name="magical-mj",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
app.command("list")(environments.list_environments)
app.command("view")(environments.view)
app.command("rollout")(evaluate.rollout)
app.command("evaluate")(evaluate.evaluate)
app.command("report")(results.make_report)
app.command("compare")(results.make_comparison)
app.command("verify")(leaderboard.verify_folder)
app.command("submit")(leaderboard.make_entry)
app.command("leaderboard")(leaderboard.make_leaderboard)
demos.app.command("export")(demo_exports.export)
app.add_typer(demos.app, name="demos")
app.command("play")(play.play)
app.command("export")(environments.export)
app.command("doctor")(doctor.doctor)
app.command("demo")(demo.demo)
app.command("train")(train.train)
app.command("experiment")(train.experiment)


@app.callback(invoke_without_command=True)
def start(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """The MAGICAL benchmark for robust imitation learning, on MuJoCo."""
    if version:
        typer.echo(f"magical-mj {magical_mj.__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the application; an expected error becomes one line on stderr and an exit code."""
    warnings.filterwarnings("ignore", module="glfw")  # our own error explains a missing display better
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # characters that a terminal cannot show become question marks
    try:
        with command_line(sys.argv[1:] if arguments is None else arguments):
            return app(args=arguments, prog_name="magical-mj", standalone_mode=False) or 0
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "magical-mj"
        complain(f"{error.format_message().rstrip('.')}; see {command} --help")
        return error.exit_code
    except SystemExit as ending:  # what typer makes of a closed pipe while it prints itself
        if not isinstance(ending.__context__, BrokenPipeError):
            raise
        return CLOSED_PIPE
    except typer.Abort:
        return 130
    except MagicalError as error:
        complain(str(error))
        return 2 if isinstance(error, ValueError) else 1
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "dm_control":
            raise
        complain(NO_DM_CONTROL)
        return 1
    except OSError as error:
        complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        return 1
    except MemoryError:
        complain(f"the memory is not enough: {LESS}")
        return 1
    except Exception as error:
        mujoco = sys.modules.get("mujoco")  # imported late: it may fail where there is no OpenGL
        if mujoco is None or not isinstance(error, mujoco.FatalError):
            raise
        complain(f"MuJoCo has stopped ({error}); if the memory is not enough: {LESS}")
        return 1
