"""Options and arguments that subcommands share, and options generated from settings."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args, get_origin

from typer import Argument, Option

from magical_mj import VARIANTS
from magical_mj.envs.presets import PRESETS
from magical_mj.rendering.backend import RendererName
from magical_mj.tasks import KNOWN
from magical_mj.utils.settings import Names, Settings, described


def one_of(names: Iterable[str]) -> Callable[[str], list[str]]:
    """A function for shell completion: the names that begin with the typed text."""
    return lambda incomplete: [name for name in names if name.startswith(incomplete)]


def some_of(names: Iterable[str]) -> Callable[[str], list[str]]:
    """A function for shell completion of lists separated by commas: it completes the last name."""

    def complete(incomplete: str) -> list[str]:
        done, comma, last = incomplete.rpartition(",")
        return [f"{done}{comma}{name}" for name in ("all", *names) if name.startswith(last)]

    return complete


TASK_HELP = (
    f"One of {', '.join(KNOWN)}, a task of an installed package, package.module:SPEC, or an intent such as "
    '"intent:in(colour=red, region)". See docs/intents.md.'
)
VARIANT_HELP = f"One of {', '.join(VARIANTS)}."

WIDEST = 30  # letters of a list of choices: a wider one does not fit into narrow terminals
COMPLETIONS = {"tasks": some_of(KNOWN), "variants": some_of(VARIANTS), "preset": one_of(PRESETS)}

Task = Annotated[str, Argument(help=TASK_HELP, autocompletion=one_of(KNOWN))]
OptionalTask = Annotated[str | None, Argument(help=TASK_HELP, autocompletion=one_of(KNOWN))]
Variant = Annotated[str, Argument(help=VARIANT_HELP, autocompletion=one_of(VARIANTS))]
Tasks = Annotated[str, Option(help="Tasks, separated by commas; or all.", autocompletion=COMPLETIONS["tasks"])]
Variants = Annotated[str, Option(help="Variants, separated by commas; or all.", autocompletion=COMPLETIONS["variants"])]
Seed = Annotated[int, Option(min=0, help="The seed of the scene.")]
Size = Annotated[int, Option(min=16, max=2048, help="Side of each picture in pixels.")]
Cameras = Annotated[str, Option(help="Views side by side, separated by commas: allo, ego, and scene (3-D).")]
Jobs = Annotated[int | None, Option(min=1, help="Worker processes.", show_default="one per core")]
Renderer = Annotated[
    RendererName | None, Option(help="The renderer of flat views.", show_default="opengl where it works")
]
Shifts = Annotated[str, Option(help="Shifts with strengths, such as camera:3,latency:1. See docs/shifts.md.")]
Body = Annotated[str, Option(help="The robot's body. See docs/bodies.md.")]
Trusted = Annotated[
    str, Option(help="Code that files may refer to, such as mine:SPEC, separated by commas. See docs/trust.md.")
]
Force = Annotated[bool, Option("--force", help="Replace existing files.")]
Folders = Annotated[list[Path], Argument(help="The folders of evaluations, or entries of the leaderboard.")]


def choices(kind: Any) -> list[str]:
    """The names of a `Literal`, or of a `Literal` or None. Empty for other types."""
    return [name for part in (kind, *get_args(kind)) if get_origin(part) is Literal for name in get_args(part)]


def add_flags(command: Callable[..., None], flags: Mapping[str, str]) -> None:
    """Adds flags, name -> help, to a command with `**options`."""
    *named, _ = inspect.signature(command, eval_str=True).parameters.values()
    kind = inspect.Parameter.KEYWORD_ONLY
    added = [
        inspect.Parameter(name, kind, default=False, annotation=Annotated[bool, Option(f"--{name}", help=text)])
        for name, text in flags.items()
    ]
    command.__signature__ = inspect.Signature([*named, *added])


def add_options(
    command: Callable[..., None],
    *settings: type[Settings],
    only: Sequence[str] = (),
    panels: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> None:
    """Adds options for settings to a command with `**options`: all except its parameters, or `only` these.

    `panels` are headings in the help, with names of settings. Other settings are below the `panel` of their class.
    """
    *named, _ = inspect.signature(command, eval_str=True).parameters.values()
    parameters = {parameter.name: parameter for parameter in named}
    every = {name: (kind, setting) for kind in settings for name, setting in described(kind).items()}
    for name, (owner, setting) in every.items():
        if name not in parameters and (not only or name in only):
            declared = [f"--{name.replace('_', '-')}"] if setting.kind is bool else []
            kind = str if setting.kind == Names else setting.kind  # lists are separated by commas
            option = Option(
                *declared,
                help=setting.description,
                min=setting.least,
                metavar=f"<{name}>" if len("|".join(choices(setting.kind))) > WIDEST else None,
                autocompletion=COMPLETIONS.get(name),
                rich_help_panel=next((title for title, names in panels.items() if name in names), owner.panel_of(name)),
            )
            parameters[name] = inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=setting.default, annotation=Annotated[kind, option]
            )
    command.__signature__ = inspect.Signature(list(parameters.values()))
