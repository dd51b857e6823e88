"""Kills commands at random moments, and checks that nothing is lost, and that no process stays behind.

    python tools/kills.py [--kills 20] [--kinds evaluate,train-bc] [--seed 0]

- After each kill, what was finished before is still there, unchanged, and every file is whole.
- The command goes on with what is there, and what it has made in the end is, to the bit, what it makes undisturbed.
- A few seconds after each kill, no process that the command had started is left.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image

from magical_mj import demos

SIGNALS: Final = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
PATIENCE: Final = 20.0
"""Seconds within which all processes must be gone."""
PLAYING: Final = 8.0
"""Seconds within which somebody who plays without end is killed."""
MAIN: Final = (sys.executable, "-m", "magical_mj")
PLAYER: Final = """
import random, sys
from magical_mj.cli import main
from magical_mj.cli.play import Window
Window.action = lambda self: random.randrange(1, 18)
wish = Window.wish  # to which SDL brings SIGTERM
Window.wish = lambda self: wish(self) or ("next" if random.random() < 0.02 else None)
Window.show = lambda self, *_: None
sys.exit(main(sys.argv[1:]))
"""  # somebody who plays without end, at any speed
SAMPLER: Final = """
import pathlib, sys
from magical_mj.utils import files
from magical_mj.batched.scenes import Capacity, SceneSampler
out, number = pathlib.Path(sys.argv[-1]), 0
out.mkdir(exist_ok=True)
sampler = SceneSampler([("FindDupe", "All")] * 256, Capacity(10, 3), workers=2)
while number := number + 1:
    files.write(out / str(number), sampler.scenes(range(256)).poses.tobytes(), overwrite=True)
"""  # the scenes of batched worlds, sampled ahead by workers without end; without a guard for `__main__`
TINY: Final = ("network.hidden=8", "demonstrations=2", "evaluations=2", "episodes=2", "checkpoints=16")
PICTURES: Final = ("network.first_stride=4", "network.first_channels=4", "network.channels=4")
GAIL: Final = (
    *("ppo.environments=4", "ppo.steps=4", "ppo.minibatch=8", "ppo.epochs=2", "ppo.total_steps=512"),
    *("discriminator.steps=2", "discriminator.batch_size=8"),
)

Found = Mapping[str, bytes]
"""What a command has finished so far, by name."""


@dataclass(frozen=True)
class Kind:
    """A command that is killed.

    Attributes:
        command: without its --out.
        finished: what is finished in the folder, which must be there after each kill as it was before. It raises an
            error if something there is not whole.
        result: what depends on nothing but the command; None of one that never ends by itself.
    """

    command: tuple[str, ...]
    finished: Callable[[Path], Found]
    result: Callable[[Path], Found] | None

    def into(self, out: Path) -> tuple[str, ...]:
        """The whole command."""
        return (*self.command, "--record" if "play" in self.command else "--out", str(out))


def demonstrations(out: Path) -> Found:
    """The files of demonstrations, each of which can be read."""
    paths = demos.files_in(out) if out.exists() else []
    for path in paths:
        demos.read(path)
    return {path.name: path.read_bytes() for path in paths}


def lines(out: Path) -> Found:
    """The whole lines of an evaluation's file, by their numbers."""
    path = out / "scores.jsonl"
    text = path.read_text().split("\n")[:-1] if path.exists() else []
    return {str(number): line.encode() for number, line in enumerate(text)}


def rows(out: Path) -> Found:
    """The episodes of an evaluation, without the time that they took."""
    episodes = [json.loads(line) | {"seconds": 0} for line in lines(out).values()]
    return {json.dumps(row, sort_keys=True): b"" for row in episodes}


def pages(out: Path) -> Found:
    """A report's texts; its pictures, which hold the time, must open."""
    paths = [path for path in out.glob("*") if not path.name.startswith(".")]
    for path in paths:
        if path.suffix == ".png":
            with Image.open(path) as picture:
                picture.load()
        elif path.suffix == ".pdf" and not path.read_bytes().rstrip().endswith(b"%%EOF"):
            raise SystemExit(f"{path} is not whole")
    return {path.name: b"" if path.suffix in (".png", ".pdf") else path.read_bytes() for path in paths}


def training(out: Path) -> Found:
    """A checkpoint and a policy can be read; that of the last update, and the metrics, depend on the settings alone."""
    from magical_mj.learners import checkpoint
    from magical_mj.learners.policy import POLICY
    from magical_mj.learners.run_folder import CHECKPOINT, read_metrics

    digests = {"metrics": repr([row | {"seconds": ""} for row in read_metrics(out)]).encode()}
    for name in (CHECKPOINT, POLICY):
        if (out / name).exists():
            tree = checkpoint.read(out / name)
            digests[name] = repr(sorted(tensors(tree))).encode()
    return digests


def tensors(tree: object, name: str = "") -> list[tuple[str, str]]:
    """The digest of each tensor and value in nested dicts and lists, the seconds that a training took apart."""
    if isinstance(tree, dict):
        return [digest for key, item in tree.items() if key != "seconds" for digest in tensors(item, f"{name}/{key}")]
    if isinstance(tree, list):
        return [digest for key, item in enumerate(tree) for digest in tensors(item, f"{name}/{key}")]
    data = tree.numpy().tobytes() if hasattr(tree, "numpy") else repr(tree).encode()  # type: ignore[union-attr]
    return [(name, hashlib.sha256(data).hexdigest())]


def scenes(out: Path) -> Found:
    """The files of scenes."""
    return {path.name: path.read_bytes() for path in out.glob("[0-9]*")}


def updates(out: Path) -> Found:
    """The updates of a training that are in its checkpoint; everything can be read."""
    from magical_mj.learners import checkpoint
    from magical_mj.learners.run_folder import CHECKPOINT

    training(out)
    done = checkpoint.read(out / CHECKPOINT)["update"] if (out / CHECKPOINT).exists() else 0
    return {str(update): b"" for update in range(done)}


def train(method: str, look: tuple[str, ...], *settings: str) -> Kind:
    """A training of a second or two, beside the time that the command takes to start."""
    words = [word for setting in (*TINY, *settings) for word in ("--set", setting)]
    command = (*MAIN, "train", method, "--tasks", "MoveToRegion", "--device", "cpu", "--resume", *look, *words)
    return Kind(command, updates, training)


def kinds(scores: Path) -> dict[str, Kind]:
    """All commands, by name; the report is one of an evaluation in this folder."""
    evaluate = ("evaluate", "--policy", "random", "--tasks", "MoveToRegion,FixColour", "--episodes", "60", "--resume")
    generate = ("demos", "generate", "--tasks", "FixColour,MoveToRegion", "--count", "20", "--jobs", "2")
    play = ("play", "MoveToRegion", "Jitter", "--size", "16")
    return {
        "evaluate": Kind((*MAIN, *evaluate, "--jobs", "2"), lines, rows),
        "report": Kind((*MAIN, "report", str(scores)), pages, pages),
        "generate": Kind((*MAIN, *generate), demonstrations, demonstrations),
        "play": Kind((sys.executable, "-c", PLAYER, *play), demonstrations, None),
        "scenes": Kind((sys.executable, "-c", SAMPLER), scenes, None),
        "train-bc-state": train("bc", ("--preset", "State"), "network.entity=8", "bc.batches=800"),
        "train-bc": train("bc", ("--quick",), *PICTURES, "bc.batches=32", "bc.batch_size=8"),
        "train-gail": train("gail", ("--quick",), *PICTURES, *GAIL),
    }


def kill(kind: Kind, name: str, folder: Path, kills: int, rng: random.Random) -> None:
    """Kills a command again and again, and lets it end; an error tells what is not as it must be."""
    expected, seconds = None, PLAYING
    if kind.result is not None:
        start = time.monotonic()
        undisturbed(kind, folder / "undisturbed")
        seconds = time.monotonic() - start
        expected = kind.result(folder / "undisturbed")
    out, ends = folder / "killed", 0
    for number in range(kills):
        before = kind.finished(out)
        start = time.monotonic()
        how, ended = killed(kind.into(out), seconds, rng)
        now = kind.finished(out)
        lost = [thing for thing in before if now.get(thing) != before[thing]]
        if lost:
            raise SystemExit(f"{name}, {how}: lost or changed: {', '.join(lost)}")
        print(f"{name} {number}: {how}; {len(now) - len(before)} more, {len(now)} in all", flush=True)
        if ended and kind.result is None:
            raise SystemExit(f"{name} ended by itself; run the command to see why: {' '.join(kind.into(out))}")
        if ended and kind.result is not None:
            ends, seconds = ends + 1, min(seconds, time.monotonic() - start)
            compare(name, kind.result(out), expected)
            shutil.rmtree(out)
    if kind.result is not None:
        undisturbed(kind, out)
        compare(name, kind.result(out), expected)
    elif not kind.finished(out):
        raise SystemExit(f"{name} has finished nothing between {kills} kills; allow more (--kills)")
    same = "" if kind.result is None else ", the same in the end"
    print(f"{name}: {kills} kills, {ends} of them too late; nothing lost, no process left{same}")


def compare(name: str, found: Found, expected: Found | None) -> None:
    """Ends the program if what was made is not what is made undisturbed."""
    if expected is None or found.keys() != expected.keys():
        raise SystemExit(f"{name}: there is {sorted(found)}, and there must be {sorted(expected or ())}")
    differing = [thing for thing in found if found[thing] != expected[thing]]
    if differing:
        raise SystemExit(f"{name}: not what it is undisturbed: {', '.join(differing)}")


def undisturbed(kind: Kind, out: Path) -> None:
    """Lets a command end."""
    result = subprocess.run(kind.into(out), capture_output=True, text=True, check=False, env=variables())
    if result.returncode != 0:
        raise SystemExit(f"{' '.join(kind.into(out))}: {result.stderr}")


def killed(command: tuple[str, ...], latest: float, rng: random.Random) -> tuple[str, bool]:
    """Starts a command and kills it within so many seconds; returns how and when, and whether it had ended before."""
    process = subprocess.Popen(
        command, start_new_session=True, env=variables(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    moment, how, ended = rng.uniform(0, latest), rng.choice(SIGNALS), False
    try:
        process.wait(moment)
        ended = True
    except subprocess.TimeoutExpired:
        process.send_signal(how)  # to the process alone; its workers must notice by themselves
        process.wait()
    start = time.monotonic()
    while left := session(process.pid):
        if time.monotonic() - start > PATIENCE:
            raise SystemExit(f"{how.name} after {moment:.1f} s left processes: {left}")
        time.sleep(0.05)
    gone = f"all gone {time.monotonic() - start:.1f} s later"
    return (f"had ended before {moment:.1f} s" if ended else f"{how.name} after {moment:.1f} s, {gone}"), ended


def session(leader: int) -> list[int]:
    """The processes of a session."""
    processes = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        if int(fields[3]) == leader and fields[0] != "Z":
            processes.append(int(stat.parent.name))
    return processes


def variables() -> dict[str, str]:
    """The environment of each command: no window is seen, and sums are the same each time."""
    return os.environ | {"SDL_VIDEODRIVER": "dummy", "OMP_NUM_THREADS": "1"}


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20, help="of each command")
    parser.add_argument("--kinds", default="all", help="which commands, separated by commas")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore it in what they start in the background
    with tempfile.TemporaryDirectory() as name:
        scores = Path(name) / "scores"
        every = kinds(scores)
        chosen = list(every) if arguments.kinds == "all" else arguments.kinds.split(",")
        if unknown := set(chosen) - set(every):
            parser.error(f"there are the kinds {', '.join(every)}, and not {', '.join(unknown)}")
        if "report" in chosen:
            undisturbed(every["evaluate"], scores)
        for kind in chosen:
            folder = Path(name) / kind
            folder.mkdir()
            kill(every[kind], kind, folder, arguments.kills, random.Random(arguments.seed))  # noqa: S311  no secret


if __name__ == "__main__":
    main()
