"""`magical-mj inspect`: inspect any running model in a browser."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import magical_mj
from magical_mj.cli import option
from magical_mj.cli.console import check_fits
from magical_mj.tasks.registry import ENVIRONMENTS, task_spec, variant_name
from magical_mj.utils.extras import check_extra
from magical_mj.web.cli.serve import Host, Port, check_seed_in_browser, serve_until_interrupted


def inspect(
    context: typer.Context,
    model: Annotated[str, Argument(metavar="TASK|FILE", help="A task, or an MJCF file (.xml).")],
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    folder: Annotated[
        list[Path] | None, Option(help="Another folder whose files FILE may use, besides its own; several times.")
    ] = None,
    host: Host = "127.0.0.1",
    port: Port = 8008,
) -> None:
    """Serve a page that simulates a model in 3-D and shows its bodies, joints, contacts, sensors and actuators.

    It prints the page's address. The first time, npm fetches MuJoCo's WebAssembly build and two libraries (5 MB).
    """
    is_file = model.lower().endswith((".xml", ".mjcf"))
    check_fits(context, not is_file, "with TASK", "variant", "seed")
    check_fits(context, is_file, "with FILE", "folder")
    check_extra("models in a browser", "web")
    from magical_mj.engine.export import mjcf_text  # imported late: it loads the simulator
    from magical_mj.web.inspection import InspectServer, model_files

    if is_file:
        files, fragment = model_files(Path(model), folder or ()), "#file"
    else:
        name = f"{task_spec(model).name}-{variant_name(variant)}-{check_seed_in_browser(seed)}"
        if (task_spec(model).name, variant_name(variant)) in ENVIRONMENTS:
            files, fragment = {}, f"#{name}"
        else:
            with closing(magical_mj.Engine(model, variant, seed=seed)) as engine:
                files, fragment = {f"{name}.xml": mjcf_text(engine).encode()}, "#file"
    serve_until_interrupted(InspectServer(ENVIRONMENTS, host, port, model=files), f"inspect.html{fragment}")
