"""`magical-mj demos`: make, import, check, show and export demonstrations."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table
from typer import Argument, Option

import magical_mj
from magical_mj.cli import option
from magical_mj.cli.console import check_suffix, check_writable, complain, console, make_writable_folder, with_bar
from magical_mj.cli.film import film
from magical_mj.cli.stored_demos import Paths, Set, asked_for, read_asked, read_chosen, sources_of
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.registry import parse_shifts, shift_label
from magical_mj.tasks.registry import SPLITS, Pair, environments, task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, MagicalError, SettingsError, UntrustedNameError, counted
from magical_mj.utils.parallel import map_here, map_unordered
from magical_mj.utils.settings import LARGEST_SETTING

if TYPE_CHECKING:  # imported late: it loads the simulator, which help does not need
    from magical_mj.demos import Demonstration, Verdict
    from magical_mj.evaluation.worker import Player

Key = tuple[str, str, int]
"""Task, variant and number."""

Folder = Annotated[Path, Option(help="The folder; existing files are kept.")]
app = typer.Typer(help="Make, import, check, show and export demonstrations.", add_completion=False)


@app.callback(invoke_without_command=True)
def start(context: typer.Context) -> None:
    """Print the help if no command is given."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def generate(
    out: Folder,
    tasks: option.Tasks = "all",
    variants: option.Variants = "Demo",
    count: Annotated[
        int, Option(min=1, max=LARGEST_SETTING, help="Number in each environment, in the scenes of seeds 0, 1, ...")
    ] = 25,
    least_score: Annotated[float, Option(min=0, max=1, help="The lowest score of a demonstration.")] = 1.0,
    body: option.Body = GRIPPER,
    shifts: Annotated[str, Option(help="Physical shifts, such as clutter:3; see docs/shifts.md.")] = "",
    jobs: option.Jobs = None,
) -> None:
    """Record demonstrations of the expert. Called again, it continues; nothing is overwritten."""
    from magical_mj.demos.demonstration import check_physical  # imported late: it loads the simulator

    pairs = environments(tasks, variants)
    for task, _ in pairs:
        task_spec(task).check_expert_body(body)
        check_physical(shift_label(parse_shifts(shifts, task)))
    label = shift_label(parse_shifts(shifts))
    parts = ("" if body == GRIPPER else body.rpartition(":")[2], label.replace(":", ""))
    by = "".join(f"-{part}" for part in parts if part)
    keys = [(*pair, number) for pair in pairs for number in range(count)]
    paths = {key: out / f"{task_spec(key[0]).name}-{key[1]}{by}-{key[2]:03}.npz" for key in keys}
    make = partial(magical_mj.demos.demonstrate, least_score=least_score, body=body, shifts=label)
    failures = make_missing(paths, make, out, jobs, "demonstrating", body, least_score)
    describe([magical_mj.demos.read(path, key[0], trusted=[body]) for key, path in paths.items() if path.exists()])
    check_made(failures)


@app.command()
def rollouts(
    out: Folder,
    policy: Annotated[
        str, Option(help="random, noop, module:object, the folder of a training, or a model file.")
    ] = "random",
    tasks: option.Tasks = "all",
    variants: option.Variants = "Demo,All",
    steps: Annotated[
        int, Option(min=1, max=LARGEST_SETTING, help="The least number of steps in each environment.")
    ] = 10_000,
    preset: Annotated[
        str | None,
        Option(
            help="The policy's observations. An export may use another preset.",
            show_default="the one of its training, or LoRes4E",
        ),
    ] = None,
    jobs: option.Jobs = None,
) -> None:
    """Record episodes of a policy, as data without labels. Called again, it continues; nothing is overwritten.

    They have the format of demonstrations, so `export` accepts them. Their scenes are never test scenes.
    """
    from magical_mj.evaluation.settings import EvaluationSettings
    from magical_mj.evaluation.worker import Player, prepared

    settings = EvaluationSettings(tasks=tasks, variants=variants, split="dev", preset=preset)
    (source, *others), settings = prepared(policy, settings)
    if others:
        raise typer.BadParameter("give one policy; use another folder for another policy.")
    keys = [
        (*pair, SPLITS["dev"] + k)
        for pair in settings.environments
        for k in range(math.ceil(steps / task_spec(pair[0]).horizon()))
    ]
    paths = {key: out / f"{task_spec(key[0]).name}-{key[1]}-{source.name}-{key[2]}.npz" for key in keys}
    check_repeats({key: path for key, path in paths.items() if path.exists()}, Player([source], settings))
    play = partial(roll_out, Player([source], settings))
    check_made(make_missing(paths, play, out, jobs, f"playing {source.name}"))
    total = sum(task_spec(task).horizon() for task, _, _ in keys)
    console().print(f"{out}: {counted(len(paths), 'episode')} with {total} steps", soft_wrap=True)


def roll_out(player: Player, task: str, variant: str, seed: int) -> Demonstration:
    """The episode of a player's only policy in the scene of a seed. A `DemonstrationError` if the policy failed."""
    from magical_mj.evaluation.worker import Unit
    from magical_mj.policies.interface import actions_of

    (source,) = player.policies.values()
    (result,) = player.play(Unit(source.name, source.run, task, variant, (seed,)))
    if result.failure is not None:
        raise DemonstrationError(f"{source.name} failed in {task}-{variant}, seed {seed}: {result.failure}")
    demonstrator = "random" if source.origin == "random" else "policy"
    return magical_mj.demos.recorded(task, variant, seed, actions_of(result.actions), demonstrator)


def check_repeats(known: Mapping[Key, Path], player: Player) -> None:
    """Raises a `SettingsError` if a player's only policy acts differently in all of three known episodes."""
    tried = list(known)[:: -(-len(known) // 3) or 1]
    with closing(player):
        for key in tried:
            again = roll_out(player, *key)
            if np.array_equal(again.actions, magical_mj.demos.read(known[key], key[0]).actions):
                return
    if tried:
        raise SettingsError(
            f"{known[tried[0]]} is by another policy with the same name, which acts differently: give another folder. "
            "If it is the same policy, it is random, and must draw its random numbers from episode.rng()"
        )


def make_missing(
    paths: Mapping[Key, Path],
    make: Callable[..., Demonstration],
    out: Path,
    jobs: int | None,
    doing: str,
    body: str = GRIPPER,
    least_score: float = 0.0,
) -> list[str]:
    """Writes the demonstrations of `paths`, in the folder `out`, that are missing. Returns the errors of failed ones.

    `make` returns the demonstration for a key of `paths`. `doing` is the label of the progress bar. A `SettingsError`
    if an existing one is outdated, or its score is less than `least_score`.
    """
    if len(set(paths.values())) < len(paths):
        raise SettingsError("two of these tasks have the same name, so their files would as well: use two folders")
    make_writable_folder(out)
    screen = console()
    read = partial(magical_mj.demos.read, trusted=[body])
    there = {key for key, path in paths.items() if path.exists()}
    for key in sorted(there):
        demo = read(paths[key], key[0])
        if not demo.is_current:
            raise SettingsError(
                f"{paths[key]} does not start in the scene of its variant and seed any more, since the task has "
                "changed: give another folder"
            )
        if least_score and (reached := demo.rescored()) < least_score:
            raise SettingsError(
                f"{paths[key]} exists already, but its score {reached:.2f} is less than {least_score:g}: give another "
                "folder, or a lower --least-score"
            )
    if there:
        screen.print(f"{len(there)} of {len(paths)} exist already")
    order = {pair: number for number, pair in enumerate(dict.fromkeys(key[:2] for key in paths))}
    todo = [(key, paths[key]) for key in sorted(paths, key=lambda key: -order[key[:2]]) if key not in there]
    try:
        messages = list(with_bar(screen, doing, _mapped(partial(write_one, make), todo, jobs), len(todo)))
    except KeyboardInterrupt:
        finished = sum(path.exists() for path in paths.values())
        complain(f"interrupted: {finished} of {len(paths)} demonstrations are in {out}; the same command continues")
        raise
    return sorted(filter(None, messages))


def _mapped(function: Callable[[Any], Any], items: Sequence[Any], jobs: int | None) -> Iterator[Any]:
    """The function's results; with one job, or one item, of this process."""
    alone = jobs == 1 or len(items) == 1
    return map_here(function, items) if alone else map_unordered(function, items, jobs)


def check_made(failures: Sequence[str]) -> None:
    """Raises a `DemonstrationError` if there are any failures."""
    if failures:
        raise DemonstrationError(f"{counted(len(failures), 'demonstration')} could not be made: {'; '.join(failures)}")


def write_one(make: Callable[..., Demonstration], work: tuple[Key, Path]) -> str:
    """Makes and writes one demonstration. Returns an error message, or "" if none."""
    key, path = work
    try:
        magical_mj.demos.write(make(*key), path)
    except FileExistsError:  # another command, which generates into the same folder, was faster
        return ""
    except DemonstrationError as error:
        return str(error)
    return ""


@app.command(name="import")
def import_recordings(
    recordings: Annotated[
        list[Path], Argument(help="JSON files that the browser saved, or the original's demo-*.pkl.gz.")
    ],
    out: Folder,
) -> None:
    """Import episodes that were saved in the browser, or released with the original, and replay them in MuJoCo."""
    episodes = [(file, *imported(file)) for file in recordings]  # all are replayed before any is written
    make_writable_folder(out)
    screen = console()
    for file, demo, remark in episodes:
        path, is_new = magical_mj.demos.keep(demo, out)
        if not is_new:
            screen.print(f"{file} was imported already: {path}", soft_wrap=True)
            continue
        screen.print(f"{path}: score {demo.score:.2f}{remark}", soft_wrap=True)
    scoring = sum(demo.score == 1.0 for _, demo, _ in episodes)
    screen.print(f"{scoring} of {counted(len(episodes), 'episode')} have score 1")


def imported(file: Path) -> tuple[Demonstration, str]:
    """The demonstration in a file, and how its replay differs from what was recorded."""
    if file.name.endswith(".pkl.gz"):
        demo, score = magical_mj.demos.from_original(file)
        return demo, "" if score is None else f", in the original's simulation {score:.2f}"
    text = files.read_foreign(file, most=magical_mj.demos.MAX_BYTES, error=DemonstrationError)
    try:
        demo, deviation, suspect = magical_mj.demos.from_recording(text)
    except MagicalError as error:
        raise DemonstrationError(f"{file}: {error}") from None
    return demo, f", but its end differs by {deviation:.3f} from what the player saw" if suspect else ""


@app.command()
def info(paths: Paths = None, tasks: option.Tasks = "all", variants: option.Variants = "all", which: Set = "1") -> None:
    """Summarise demonstrations: scores, lengths, and their diversity."""
    describe(read_chosen(paths, tasks, variants, which))


def describe(demos: Sequence[Demonstration]) -> None:
    """Prints a table with a row for each environment."""
    table = Table(box=None, header_style="bold", padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("environment", no_wrap=True)
    for column in ("by", "demos", "score", "steps", "actions", "orders", "strategies", "path distance"):
        table.add_column(column, overflow="fold")
    groups: dict[tuple[str, str], list[Demonstration]] = defaultdict(list)
    for demo in demos:
        groups[demo.name, demo.demonstrator].append(demo)
    for names, group in groups.items():
        orders, strategies, distance = magical_mj.demos.diversity(group)
        score = fmean(demo.score for demo in group)
        steps = fmean(len(demo.actions) for demo in group)
        actions = fmean(np.count_nonzero(demo.acts) for demo in group)
        numbers = (len(group), f"{score:.3f}", f"{steps:.0f}", f"{actions:.0f}", orders, strategies, f"{distance:.2f}")
        table.add_row(*names, *map(str, numbers))
    screen = console()
    screen.print(table)
    screen.print(
        "actions: steps with an action that is not the no-op. orders: different orders in which blocks are moved. "
        "strategies: different orders and gripped sides of the blocks. path distance: mean distance between the "
        "robot's paths, in world units."
    )


@app.command(name="verify")
def verify_all(
    paths: Paths = None,
    tasks: option.Tasks = "all",
    variants: option.Variants = "all",
    which: Set = "1",
    jobs: option.Jobs = None,
) -> None:
    """Check digests, replay all actions, and count those that reproduce their score, states and pictures.

    The exit code is 1 if a file is damaged, does not begin in its scene, or does not reproduce its score. States can
    differ between machines and versions.
    """
    screen = console()
    chosen = sources_of(paths, tasks, variants, which)
    work = _mapped(partial(check, asked_for(tasks, variants)), chosen, jobs)
    outcomes = [outcome for outcome in with_bar(screen, "verifying", work, len(chosen)) if outcome is not None]
    if not outcomes:
        raise DemonstrationError(f"none of the {len(chosen)} demonstrations is of these tasks and variants")
    replayed = [outcome for outcome in outcomes if outcome.replayed]
    verdicts = [outcome.verdict for outcome in replayed if outcome.verdict is not None]
    same_score = sum(verdict.score and verdict.replay for verdict in verdicts)
    exact, pictures = (sum(getattr(verdict, name) for verdict in verdicts) for name in ("exact", "pictures"))
    if replayed:
        screen.print(
            f"{same_score} of {len(replayed)} replay to the same score, {exact} through the same states, {pictures} "
            "with the same pictures"
        )
    if left := len(outcomes) - len(replayed):
        screen.print(f"{left} not replayed")
    problems = {outcome.problem for outcome in outcomes if outcome.problem}  # one line for each unnamed task
    for problem in sorted(problems):
        complain(problem)
    if sum(verdict.good for verdict in verdicts) < len(outcomes):
        raise typer.Exit(1)


class Checked(NamedTuple):
    """The outcome for one demonstration, which was not `replayed` if it needs the code of a task that is not named."""

    verdict: Verdict | None
    problem: str | None
    replayed: bool = True


def check(wanted: Collection[Pair] | None, source: Path | Demonstration) -> Checked | None:
    """Checks one demonstration. None if it is not in the `wanted` environments."""
    name = str(source) if isinstance(source, Path) else f"{source.name} {source.scene_seed}"
    try:
        if isinstance(demo := read_asked(source, wanted), str):
            return None
        verdict = magical_mj.demos.verify(demo)
        return Checked(verdict, verdict.problem and f"{name} {verdict.problem}")
    except UntrustedNameError as error:
        return Checked(None, str(error), replayed=False)
    except DemonstrationError as error:
        return Checked(None, str(error))
    except MagicalError as error:
        return Checked(None, f"{name}: {error}")


@app.command()
def video(
    out: Annotated[Path, Option(help="The MP4 file.")],
    paths: Paths = None,
    tasks: option.Tasks = "all",
    variants: option.Variants = "all",
    which: Set = "1",
    count: Annotated[int, Option(min=1, help="The largest number of demonstrations in the video.")] = 1,
    size: option.Size = 384,
    speed: Annotated[int, Option(min=1, max=30, help="Times real time.")] = 1,
    renderer: option.Renderer = None,
    force: option.Force = False,
) -> None:
    """Make a video of demonstrations, with both views side by side."""
    check_suffix(out, ".mp4")
    demos = read_chosen(paths, tasks, variants, which)[:count]
    check_writable(out, force)
    with film(out, size, speed, overwrite=force) as movie:
        for demo in demos:
            title = f"{demo.task} {demo.variant}, seed {demo.scene_seed}: {demo.demonstrator}"
            frames = magical_mj.demos.render_demo(demo, ("allo", "ego"), size, renderer)
            for step, pictures in enumerate(frames):
                views = np.concatenate([pictures["allo"], pictures["ego"]], axis=1)
                reached = demo.rescored(step)
                if step == 0:
                    movie.begin(title, views, reached)
                else:
                    movie.add(views, step, demo.actions[step - 1], reached)
            movie.end()
    console().print(out, soft_wrap=True)
