"""`magical-mj demos`: make demonstrations, check them, look at them, and hand them to other tools."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer
from rich.table import Table

import magical_mj
from magical_mj import TASKS, VARIANTS
from magical_mj.cli.console import Force, Size, check_suffix, claim, claim_folder, console
from magical_mj.cli.film import film_pictures
from magical_mj.cli.parallel import Jobs, in_parallel
from magical_mj.errors import DemonstrationError, MagicalError
from magical_mj.registry import environment_axes, task_spec, variant_name

if TYPE_CHECKING:  # magical_mj.demos starts OpenGL, which help and wrong arguments do without
    from magical_mj.demos import Demonstration, Imported, Verdict

ALL = "all"
SUFFIX = ".npz"

Tasks = Annotated[list[str], typer.Argument(help=f"One or more of {', '.join(TASKS)}; or {ALL}.", show_default=False)]
Paths = Annotated[
    list[str], typer.Argument(help="Files, folders, or tasks (their shipped demonstrations).", show_default=False)
]
Variant = Annotated[str, typer.Option(help=f"One of {', '.join(VARIANTS)}.")]
Count = Annotated[int, typer.Option(min=1, help="How many of each task: those of seeds 0, 1, ...")]
Folder = Annotated[Path, typer.Option("--out", help="The folder; what is there already is kept.", show_default=False)]
Recordings = Annotated[list[Path], typer.Argument(help="The JSON files that the browser saved.", show_default=False)]
Least = Annotated[float, typer.Option(min=0, max=1, help="The score that a demonstration must have.")]

app = typer.Typer(help="Demonstrations by the experts: make, check, see and export them.", no_args_is_help=True)


@app.command()
def generate(
    tasks: Tasks, out: Folder, variant: Variant = "Demo", count: Count = 25, least_score: Least = 1.0, jobs: Jobs = None
) -> None:
    """Let the experts demonstrate tasks. Called again, it goes on where it was stopped; nothing is overwritten."""
    names = TASKS if ALL in tasks else tuple(task_spec(task).name for task in tasks)
    for name in names:
        environment_axes(name, variant)
    claim_folder(out)
    screen = console()
    numbers = [(name, number) for name in reversed(names) for number in range(count)]  # the longest tasks first
    paths = {(name, number): out / file_name(name, variant, number) for name, number in numbers}
    for (name, _), path in paths.items():
        if path.exists():
            magical_mj.demos.read(path, name)  # or an error: a damaged file is not taken for a demonstration
    todo = [(*key, variant, least_score, path) for key, path in paths.items() if not path.exists()]
    if len(todo) < len(numbers):
        screen.print(f"{len(numbers) - len(todo)} of {len(numbers)} are there already")
    failures = [failure for failure in in_parallel(screen, "demonstrating", make, todo, jobs) if failure]
    describe([demo for name in sorted(names, key=TASKS.index) for demo in magical_mj.demos.load(name, out)])
    if failures:
        raise DemonstrationError(f"{len(failures)} demonstrations are missing: {'; '.join(sorted(failures))}")


def file_name(task: str, variant: str, number: int) -> str:
    """What the demonstration of a number is called."""
    return f"{task}-{variant_name(variant)}-{number:03}{SUFFIX}"


def make(task: str, number: int, variant: str, least_score: float, path: Path) -> str:
    """What a worker does: one demonstration; why there is none, if there is none."""
    try:
        magical_mj.demos.write(magical_mj.demos.demonstrate(task, variant, number, least_score), path)
    except DemonstrationError as error:
        return str(error)
    return ""


@app.command(name="import")
def import_recordings(files: Recordings, out: Folder) -> None:
    """Make demonstrations of episodes that were saved in the browser: replayed here, and scored anew."""
    made = [(file, _replayed(file)) for file in files]  # all of them, before anything is written
    claim_folder(out)
    screen = console()
    for file, (demo, deviation, suspect) in made:
        before = set(out.iterdir())
        path = magical_mj.demos.keep(demo, out)
        if path in before:
            screen.print(f"{file} is there already: {path}", soft_wrap=True)
            continue
        warning = f", but ends {deviation:.3f} from what the player saw" if suspect else ""
        screen.print(f"{path}: score {demo.score:.2f}{warning}", soft_wrap=True)


def _replayed(file: Path) -> Imported:
    with file.open("rb") as stream:
        text = stream.read(magical_mj.demos.MAX_BYTES + 1)
    try:
        return magical_mj.demos.from_recording(text)
    except MagicalError as error:
        raise DemonstrationError(f"{file}: {error}") from None


@app.command()
def info(paths: Paths) -> None:
    """Say what is in demonstrations: scores, lengths, and how much they differ from each other."""
    describe([demo for _, demo in _read(paths)])


def describe(demos: Sequence[Demonstration]) -> None:
    """A table with a row for each environment."""
    columns = ("environment", "by", "demos", "score", "steps", "actions", "orders", "strategies", "ways apart")
    table = Table(*columns, box=None, header_style="bold")
    groups: dict[tuple[str, str], list[Demonstration]] = {}
    for demo in demos:
        groups.setdefault((demo.name, demo.demonstrator), []).append(demo)
    for (name, demonstrator), some in groups.items():
        differ = magical_mj.demos.diversity(some)
        table.add_row(
            name,
            demonstrator,
            str(len(some)),
            f"{fmean(demo.score for demo in some):.3f}",
            f"{fmean(len(demo.actions) for demo in some):.0f}",
            f"{fmean(int((demo.actions != 0).sum()) for demo in some):.0f}",
            str(differ.orders),
            str(differ.strategies),
            f"{differ.ways:.2f}",
        )
    screen = console()
    screen.print(table)
    screen.print(
        "actions: steps in which something is done. orders, strategies: different orders in which blocks are moved, "
        "and with the sides they are taken from. ways apart: mean distance of the robot's ways, in world units."
    )


@app.command(name="verify")
def verify_all(paths: Paths, jobs: Jobs = None) -> None:
    """Check digests, replay all actions, and draw all states again; exit code 1 if anything is wrong."""
    screen = console()
    work = [(label, demo) for label, demo in _read(paths)]
    results = dict(in_parallel(screen, "verifying", check, work, jobs))
    bad = sorted(label for label, verdict in results.items() if not verdict.good)
    exact = sum(verdict.exact for verdict in results.values())
    alike = sum(verdict.pictures for verdict in results.values())
    screen.print(
        f"{len(results) - len(bad)} of {len(results)} replay to the same score, "
        f"{exact} through the same states, {alike} with the same pictures"
    )
    if bad:
        raise DemonstrationError(f"these do not replay in this version of the world: {', '.join(bad)}")


def check(label: str, demo: Demonstration) -> tuple[str, Verdict]:
    """What a worker does: one demonstration."""
    return label, magical_mj.demos.verify(demo)


@app.command()
def video(
    path: Annotated[str, typer.Argument(help="A file, or a task (its first shipped demonstration).")],
    out: Annotated[Path, typer.Option(help="The MP4 file.", show_default=False)],
    size: Size = 384,
    speed: Annotated[int, typer.Option(min=1, help="Times real time.")] = 1,
    force: Force = False,
) -> None:
    """Film a demonstration, both views side by side."""
    check_suffix(out, ".mp4")
    claim(out, force)
    demo = next(_read([path]))[1]
    with film_pictures(out, size, speed) as add:
        for pictures in magical_mj.demos.see(demo, ("allo", "ego"), size):
            add(np.concatenate([pictures["allo"], pictures["ego"]], axis=1))
    console().print(out, soft_wrap=True)


@app.command()
def export(
    paths: Paths,
    to: Annotated[Literal["npz", "minari"], typer.Option(help="A numpy archive, or a Minari data set.")] = "npz",
    out: Annotated[str | None, typer.Option(help="The file, or the data set's id.", show_default="by task")] = None,
    preset: Annotated[str, typer.Option(help="The observations.", show_default="LoRes4E; State for Minari")] = "",
    drop_noop: Annotated[bool, typer.Option(help="For npz: leave out the steps in which nothing is done.")] = True,
) -> None:
    """Hand demonstrations to other tools."""
    demos = [demo for _, demo in _read(paths)]
    if to == "minari":
        made = magical_mj.demos.to_minari(demos, out, preset or "State").spec.dataset_id
    else:
        made = Path(out or f"{demos[0].name}{SUFFIX}")
        magical_mj.demos.to_npz(demos, made, preset or "LoRes4E", drop_noop=drop_noop)
    console().print(made, soft_wrap=True)


def _read(paths: Sequence[str]) -> Iterator[tuple[str, Demonstration]]:
    """The demonstrations that are meant, each with what to call it."""
    for path in paths:
        if path in TASKS or path == ALL:
            for task in TASKS if path == ALL else (path,):
                yield from (
                    (f"{demo.name}-{number:03}", demo) for number, demo in enumerate(magical_mj.demos.load(task))
                )
        elif Path(path).is_dir():
            found = sorted(Path(path).glob(f"*{SUFFIX}"))
            if not found:
                raise DemonstrationError(f"there are no demonstrations in {path}")
            yield from ((str(file), magical_mj.demos.read(file)) for file in found)
        else:
            yield path, magical_mj.demos.read(Path(path))
