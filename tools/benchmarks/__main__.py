"""`python -m tools.benchmarks`: the speed of the environments on this machine, compared with a bare MuJoCo loop.

Run it from the checkout. Single environments are measured in processor time, vectors and batches in wall time.
"""

from __future__ import annotations

import json
import platform
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from magical_mj._version import __version__
from magical_mj.cli.app import run
from magical_mj.cli.console import Output, check_fits, console, with_bar
from magical_mj.cli.option import Renderer, Tasks, Variants, some_of
from magical_mj.envs.presets import PRESETS, preset_named
from magical_mj.rendering.backend import drawn_by
from magical_mj.tasks.registry import environments, listed
from magical_mj.utils.extras import check_extra
from magical_mj.utils.parallel import cores

if TYPE_CHECKING:
    from tools.benchmarks.batched import BatchedMeasurement
    from tools.benchmarks.single import Cause, Measurement

RESETS: Final = ("reset, same structure", "reset, new structure")
HEAD: Final = ("Environment", "Preset", "steps/s", "bare loop", "share", "32 worlds", *RESETS)
NAMES: Final = 2  # the number of columns with text
CAUSES: Final[tuple[Cause, ...]] = ("rewritten", "compiled")
BATCH_SIZES: Final = "256,1024,4096,16384"
CPU_INFO: Final = Path("/proc/cpuinfo")

Presets = Annotated[str, typer.Option(help="Presets, separated by commas; or all.", autocompletion=some_of(PRESETS))]
Steps = Annotated[
    int, typer.Option(min=1, help="The least number of steps in each environment; only whole episodes are played.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, with times in seconds of processor time.")]
Batched = Annotated[bool, typer.Option("--batched", help="Measure batched environments instead (extra gpu).")]
NumEnvs = Annotated[str, typer.Option(help="With --batched: numbers of environments, separated by commas.")]
Device = Annotated[str, typer.Option(help="With --batched: the device, cuda, cuda:1 or cpu.")]
Profile = Annotated[bool, typer.Option("--profile", help="With --batched: print the time of each kernel.")]


def bench(
    context: typer.Context,
    tasks: Tasks = "all",
    variants: Variants = "all",
    presets: Presets = "LoRes4E",
    steps: Steps = 1000,
    renderer: Renderer = None,
    as_json: Json = False,
    profile: Profile = False,
    batched: Batched = False,
    num_envs: NumEnvs = BATCH_SIZES,
    device: Device = "cuda",
) -> None:
    """Measure steps per second of processor time with resets, compared with a bare MuJoCo loop, and times of resets."""
    check_fits(context, batched, "with --batched", "num_envs", "device", "profile")
    check_fits(context, not batched, "without --batched", "steps", "renderer", "as_json")
    names = listed(presets, PRESETS)
    for name in names:
        preset_named(name)  # raises an error if it is unknown
    chosen = [(*pair, name) for name in names for pair in environments(tasks, variants)]
    if batched:
        _print_batched(chosen, _counts(num_envs), device, profile)
        return
    from tools.benchmarks.single import composer_share, measure

    work = with_bar(Output(stderr=True), "measuring", chosen, len(chosen))
    measurements = [measure(task, variant, name, steps, renderer) for task, variant, name in work]
    if as_json:
        facts = {
            "machine": machine(),
            "memory_mb": memory(),
            "renderer": drawn_by(renderer),
            "dm_env_share": composer_share(),
            "environments": [_entry(speed) for speed in measurements],
        }
        typer.echo(json.dumps(facts, indent=2))
    else:
        typer.echo(markdown_table(measurements, drawn_by(renderer)))


def _counts(text: str) -> list[int]:
    if not re.fullmatch(r"[1-9]\d*(,[1-9]\d*)*", text):
        raise typer.BadParameter(f"--num-envs must be positive numbers, separated by commas, not {text!r}.")
    return [int(part) for part in text.split(",")]


def _print_batched(chosen: Sequence[tuple[str, str, str]], counts: Sequence[int], device: str, profile: bool) -> None:
    """Measures batches of each task and variant with these sizes, and prints the lines of each at once."""
    check_extra("batched environments", "gpu")
    from magical_mj.batched.physics import check_device
    from tools.benchmarks.batched import measure_batched, single_rate

    check_device(device)
    screen = console()
    for task, variant, name in chosen:
        single = single_rate(task, variant, name)
        for count in counts:
            speed = measure_batched(task, variant, count, name, device)
            for line in _batched_lines(speed, single, profile):
                screen.print(line, soft_wrap=True)


def _batched_lines(speed: BatchedMeasurement, single: float, profile: bool) -> Iterator[str]:
    """The lines of a measurement, with the launches of each part, or with `profile` those of each kernel."""
    from tools.benchmarks.batched import by_part

    rest = speed.step_seconds - speed.physics_seconds - speed.observation_seconds
    parts = speed.step_seconds, speed.physics_seconds, speed.observation_seconds, rest, speed.reset_seconds
    times = [1000 * seconds for seconds in parts]
    yield f"{speed.task} {speed.variant}, {speed.preset}, {speed.num_envs} environments: {speed.rate:,.0f} steps/s"
    yield f"  {speed.rate / single:.3g} times as many as single environments on all cores of this machine"
    yield f"  {speed.env_bytes / 1000:.0f} kB an environment"
    line = "  a step {:.2f} ms: physics {:.2f}, observations {:.2f}, the rest {:.2f}; a reset of the batch {:.2f} ms"
    yield line.format(*times)
    launches = sum(kernel.launches for kernel in speed.kernels)
    yield f"  a step, on average: {launches:,.0f} kernel launches, {speed.bytes / 1e6:.2f} MB an environment"
    for kernel in speed.kernels if profile else by_part(speed.kernels):
        called = f"{kernel.part} {kernel.name}".strip()
        took = f"{1000 * kernel.seconds:.2f} ms, {kernel.bytes / 1e6:.1f} MB"
        yield f"  {called}: {kernel.launches:,.0f} launches, {took}"
    if profile:
        yield speed.profile


def _milliseconds(speed: Measurement, cause: Cause) -> str:
    median, most = (speed.reset_quantile(cause, share) for share in (0.5, 0.95))
    return "" if median is None or most is None else f"{1000 * median:.1f} ms ({1000 * most:.1f})"


def markdown_table(measurements: Sequence[Measurement], renderer: str) -> str:
    """The table, and below it the machine. Resets: median (95th percentile), in milliseconds."""
    rows = [
        (
            f"{speed.task} {speed.variant}",
            speed.preset or "none",
            f"{speed.rate:,.0f}",
            f"{speed.bare_rate:,.0f}",
            f"{speed.share:.0%}",
            f"{speed.vector_rate:,.0f}",
            *(_milliseconds(speed, cause) for cause in CAUSES),
        )
        for speed in measurements
    ]
    lines = [HEAD, [*["---"] * NAMES, *["---:"] * (len(HEAD) - NAMES)], *rows]
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return f"{table}\n\n{summary(measurements, renderer)}"


def summary(measurements: Sequence[Measurement], renderer: str) -> str:
    """The mean share, the machine, the memory of this process, and the speed of the dm_env interface."""
    from tools.benchmarks.single import composer_share

    here, peak, composer = machine(), memory(), composer_share()
    drawn = renderer if renderer == "software" else here["opengl"]
    share = fmean(speed.share for speed in measurements)
    text = f"on average {share:.0%} of the bare loop; {here['cpu']}, {here['cores']} cores; {drawn}"
    if peak is not None:
        text += f"; at most {peak:.0f} MB"
    return text if composer is None else f"{text}; dm_env without pictures: {composer:.0%} of the bare loop"


def _entry(speed: Measurement) -> Mapping[str, Any]:
    resets = {
        cause: {
            "count": len(speed.resets[cause]),
            "median": speed.reset_quantile(cause, 0.5),
            "p95": speed.reset_quantile(cause, 0.95),
        }
        for cause in CAUSES
    }
    names = ("task", "variant", "preset", "steps", "rate", "bare_rate", "share", "vector_rate")
    return {name: getattr(speed, name) for name in names} | {"resets": resets}


def machine() -> dict[str, str | int]:
    """The machine and the versions."""
    from magical_mj.rendering.opengl import opengl_name

    cpu = platform.processor() or platform.machine()
    if CPU_INFO.exists():
        cpu = next((line.split(": ")[1] for line in CPU_INFO.read_text().splitlines() if "model name" in line), cpu)
    return {
        "cpu": cpu,
        "cores": cores(),
        "opengl": opengl_name(),
        "python": platform.python_version(),
        "magical_mj": __version__,
    }


def memory() -> float | None:
    """The peak memory of this process in MB. None on systems that do not report it, such as Windows."""
    try:
        import resource
    except ModuleNotFoundError:
        return None
    unit = 1 if sys.platform == "darwin" else 2**10  # bytes per unit that the system reports
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark and return the exit code."""
    app = typer.Typer(add_completion=False)
    app.command(context_settings={"help_option_names": ["-h", "--help"]})(bench)
    return run(arguments, app, "python -m tools.benchmarks")


if __name__ == "__main__":
    sys.exit(main())
