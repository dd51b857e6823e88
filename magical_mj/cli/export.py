"""`magical-mj export`: a scene as a MuJoCo model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import magical_mj
from magical_mj.cli.console import Force, Seed, Task, Variant, claim, console, file_name

Out = Annotated[Path, typer.Option(help="The folder to write the model into.", show_default=False)]


def export(task: Task, out: Out, variant: Variant = "Demo", seed: Seed = 0, force: Force = False) -> None:
    """Write a scene as a self-contained MJCF model, for any program that reads MuJoCo's format."""
    scene = magical_mj.sample_scene(task, variant, seed)
    path = claim(out / file_name(task, variant, seed, ".xml"), force)
    console().print(magical_mj.export_mjcf(scene, path, overwrite=force), soft_wrap=True)
