"""Options and arguments that subcommands share, and options generated from settings."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import Annotated

from typer import Argument, Option

from magical_mj import VARIANTS
from magical_mj.envs.presets import PRESETS
from magical_mj.rendering.backend import RendererName
from magical_mj.tasks import KNOWN
from magical_mj.utils.settings import Names, described


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

METAVARS = {"control": "<control>"}
"""Names of options' values, where the list of choices would be wider than a narrow terminal."""
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
Host = Annotated[str, Option(help="The address to listen on.")]
Port = Annotated[int, Option(min=0, max=65535, help="The port to listen on; 0: any free one.")]


def add_options(command: Callable[..., None], settings: type, *names: str) -> None:
    """Adds options for settings, by default all except the command's parameters, to a command with `**options`."""
    *named, _ = inspect.signature(command, eval_str=True).parameters.values()
    parameters = {parameter.name: parameter for parameter in named}
    for name, setting in described(settings).items():
        if name not in parameters and (not names or name in names):
            declared = [f"--{name.replace('_', '-')}"] if setting.kind is bool else []
            kind = str if setting.kind == Names else setting.kind  # lists are separated by commas
            option = Option(
                *declared,
                help=setting.description,
                min=setting.least,
                metavar=METAVARS.get(name),
                autocompletion=COMPLETIONS.get(name),
            )
            parameters[name] = inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=setting.default, annotation=Annotated[kind, option]
            )
    command.__signature__ = inspect.Signature(list(parameters.values()))
