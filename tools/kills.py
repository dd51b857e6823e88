"""Stops and kills commands at random times, and checks that no result is lost and no process remains.

    python tools/kills.py [--kills 20] [--kinds evaluate,train-bc] [--seed 0]

- After each kill, all results that were finished before exist unchanged, and every file is complete.
- The command can be continued. Its final results are bit for bit those of a run without interruptions.
- A few seconds after each kill, no process that the command had started is running.
- After SIGTERM and SIGINT, it ends without a traceback. After SIGSTOP and SIGCONT, it continues normally.

At the end, it prints how many signals reached each command while it ran. For 19 mostly short commands, on 26 November
2026: KILL 37, TERM 37, INT 35, STOP 34; two of each in 16 commands, three of each in `view`, `demos import` and the
XIRL export. It found that Ctrl-C during the import of the package printed a traceback. This can still happen for a few
milliseconds, and before them while Python itself starts.
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
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image

from magical_mj import Engine, demos, sample_scene
from magical_mj.protocol import PROTOCOL

SIGNALS: Final = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGSTOP)
"""A command that was stopped is continued after a pause."""
PAUSE: Final = 1.0
"""The duration of a stop, in seconds."""
TRIES: Final = 3
"""The most signals that are sent, as a multiple of those that must reach the command."""
PATIENCE: Final = 20.0
"""Seconds within which all processes must have ended."""
PLAYING: Final = 8.0
"""Seconds within which a command without an end is killed."""
MAIN: Final = (sys.executable, "-m", "magical_mj")
PLAYER: Final = """
import random, sys
from magical_mj.cli import main
from magical_mj.cli.play import Window
Window.action = lambda self: random.randrange(1, 18)
wish = Window.wish  # SDL turns SIGTERM into a wish to quit
Window.wish = lambda self: wish(self) or ("next" if random.random() < 0.02 else None)
Window.show = lambda self, *_: None
sys.exit(main(sys.argv[1:]))
"""  # a player who never stops, without waiting between steps
SAMPLER: Final = """
import pathlib, sys
from magical_mj.utils import files
from magical_mj.batched.scenes import Sampler
out, number = pathlib.Path(sys.argv[-1]), 0
out.mkdir(parents=True, exist_ok=True)
sampler = Sampler([("FindDupe", "All")] * 256, (10, 3), lambda scenes, seeds: {}, workers=2)
try:
    while number := number + 1:
        files.write(out / str(number), sampler.episodes(range(256))[1]["poses"].tobytes(), overwrite=True)
except KeyboardInterrupt:
    pass
"""  # endless sampling of scenes for batched environments in workers; without a guard for `__main__`
EVALUATE: Final = (
    *("evaluate", "--policy", "random", "--tasks", "MoveToRegion,FixColour"),
    *("--variants", "Demo,Jitter", "--episodes", "60", "--resume", "--jobs", "2"),
)
ENTRY: Final = "random.json.xz"
TINY: Final = ("demonstrations=2", "evaluations=2", "episodes=2", "checkpoints=16")
STATES: Final = ("network.hidden=8", "network.entity=8")
PICTURES: Final = ("network.hidden=8", "network.first_stride=4", "network.first_channels=4", "network.channels=4")
SHIFTED: Final = ("evaluate", "--policy", "random", "--tasks", "MoveToRegion", "--variants", "Demo", "--episodes", "20")
GAIL: Final = (
    *("ppo.environments=4", "ppo.steps=4", "ppo.minibatch=8", "ppo.epochs=2", "ppo.total_steps=512"),
    *("discriminator.steps=2", "discriminator.batch_size=8"),
)
AL: Final = (*GAIL[:-2], "features.batches=64", "features.batch_size=4", "features.samples=24")
SMALL: Final = ("hidden=8", "trial=1", "batch_size=8", "rollouts=2", "ways=100", "plays=1", "grips=50")
RELATIONAL: Final = tuple(f"relational.{setting}" for setting in SMALL)

Found = Mapping[str, bytes]
"""Name -> content of each result that a command has finished so far."""


@dataclass(frozen=True)
class Kind:
    """A command that is killed.

    Attributes:
        command: the words of the command. {} is replaced by the folder or file that it writes.
        finished: returns the finished results in the folder, which must be the same before and after each kill. It
            raises an error if a file is incomplete.
        result: returns the final results, which depend only on the command. None if the command never ends by itself.
        code: the expected exit code.
    """

    command: tuple[str, ...]
    finished: Callable[[Path], Found]
    result: Callable[[Path], Found] | None
    code: int = 0

    def into(self, out: Path) -> tuple[str, ...]:
        """The words of the command that writes to `out`."""
        return tuple(word.replace("{}", str(out)) for word in self.command)


def demonstrations(out: Path) -> Found:
    """The files of demonstrations. All must be readable."""
    paths = demos.files_in(out) if out.exists() else []
    for path in paths:
        demos.read(path)
    return {path.name: path.read_bytes() for path in paths}


def lines(out: Path) -> Found:
    """The complete lines of the score files of evaluations, by their numbers."""
    return {
        f"{path.relative_to(out)}:{number}": line.encode()
        for path in out.rglob("scores.jsonl")
        for number, line in enumerate(path.read_text().split("\n")[:-1])
    }


def rows(out: Path) -> Found:
    """The episodes of evaluations, without their durations."""
    episodes = [json.loads(line) | {"seconds": 0} for line in lines(out).values()]
    return {json.dumps(row, sort_keys=True): b"" for row in episodes}


def pages(out: Path) -> Found:
    """The texts of a report. Its pictures, which contain the time, must be readable."""
    paths = [path for path in out.glob("*") if not path.name.startswith(".")]
    for path in paths:
        if path.suffix == ".png":
            with Image.open(path) as picture:
                picture.load()
        elif path.suffix == ".pdf" and not path.read_bytes().rstrip().endswith(b"%%EOF"):
            raise SystemExit(f"{path} is incomplete")
    return {path.name: b"" if path.suffix in (".png", ".pdf") else path.read_bytes() for path in paths}


def training(out: Path) -> Found:
    """The digests of checkpoint and policy, which depend only on the settings. The metrics must be readable."""
    from magical_mj.learners import checkpoint
    from magical_mj.learners.policy import POLICY
    from magical_mj.learners.run_folder import CHECKPOINT, read_metrics

    digests = {}
    read_metrics(out)  # not compared: Ctrl-C leaves an additional row
    for name in (CHECKPOINT, POLICY):
        if (out / name).exists():
            tree = checkpoint.read(out / name)
            digests[name] = repr(sorted(tensors(tree))).encode()
    return digests


def tensors(tree: object, name: str = "") -> list[tuple[str, str]]:
    """The digest of each tensor and value in nested dicts and lists, without the duration of a training."""
    if isinstance(tree, dict):
        return [digest for key, item in tree.items() if key != "seconds" for digest in tensors(item, f"{name}/{key}")]
    if isinstance(tree, list):
        return [digest for key, item in enumerate(tree) for digest in tensors(item, f"{name}/{key}")]
    data = tree.numpy().tobytes() if hasattr(tree, "numpy") else repr(tree).encode()  # type: ignore[union-attr]
    return [(name, hashlib.sha256(data).hexdigest())]


def contents(out: Path) -> Found:
    """The digests of all files. HDF5 files contain the time, so only their names count."""
    digests = {}
    for path in out.rglob("*"):
        name = str(path.relative_to(out))
        if path.is_file() and not any(part.startswith(".") for part in path.relative_to(out).parts):
            data = b"" if path.suffix == ".hdf5" else path.read_bytes()
            digests[name] = hashlib.sha256(data).digest()
    return digests


def nothing(_out: Path) -> Found:
    """The results of a command that only reads."""
    return {}


def scenes(out: Path) -> Found:
    """The files of scenes."""
    return {path.name: path.read_bytes() for path in out.glob("[0-9]*")}


def updates(out: Path) -> Found:
    """The updates of a training that its checkpoint contains. All files must be readable."""
    from magical_mj.learners import checkpoint
    from magical_mj.learners.run_folder import CHECKPOINT

    training(out)
    done = checkpoint.read(out / CHECKPOINT)["update"] if (out / CHECKPOINT).exists() else 0
    return {str(update): b"" for update in range(done)}


def train(method: str, look: tuple[str, ...], *settings: str) -> Kind:
    """A training of a second or two, after the start of the command. `look` are options for observations."""
    words = [word for setting in (*TINY, *settings) for word in ("--set", setting)]
    command = (*MAIN, "train", method, "--tasks", "MoveToRegion", "--device", "cpu", "--resume", *look, *words)
    command += ("--out", "{}")
    return Kind(command, updates, training)


def prepare(inputs: Path) -> None:
    """Makes the inputs of the commands: an evaluation, its entry, recordings, a training, and an experiment file."""
    kind = Kind((*MAIN, *EVALUATE, "--out", "{}"), lines, rows)
    undisturbed(kind, inputs / "scores")
    undisturbed(Kind((*MAIN, "submit", str(inputs / "scores"), "--out", "{}"), contents, None), inputs / ENTRY)
    for seed in range(8):
        scene, env = sample_scene("MoveToRegion", "All", seed), Engine("MoveToRegion", "All", seed=seed)
        while not env.over:
            env.step(seed)
        robot = env.scene.robot
        final = {"robot": [robot.x, robot.y, robot.angle], "fingers": robot.fingers, "blocks": scene.blocks}
        names = {"format": 1, "protocol": PROTOCOL, "task": "MoveToRegion", "variant": "All", "seed": seed}
        actions = [seed] * env.steps
        (inputs / f"{seed}.json").write_text(json.dumps(names | {"actions": actions, "final": final}))
    undisturbed(train("bc", ("--preset", "State"), *STATES, "bc.batches=8"), inputs / "run")
    settings = ('preset = "State"', *TINY, "bc.batches=40", *STATES)
    text = ('methods = ["bc"]', 'tasks = ["MoveToRegion"]', "seeds = [0, 1]", "[settings]", *settings)
    (inputs / "e.toml").write_text("\n".join((*text, "[evaluation]", 'variants = "Demo"', "episodes = 8")))


def kinds(inputs: Path) -> dict[str, Kind]:
    """Name -> command, with the inputs in this folder."""
    scores, entry = str(inputs / "scores"), str(inputs / ENTRY)
    generate = ("demos", "generate", "--tasks", "FixColour,MoveToRegion", "--count", "20", "--jobs", "2")
    chosen = ("--tasks", "FixColour,MoveToRegion", "--variants", "Demo")
    rollouts = ("demos", "rollouts", *chosen, "--steps", "1000", "--preset", "State", "--jobs", "2")
    play = ("play", "MoveToRegion", "Jitter", "--size", "16", "--record", "{}")
    export = ("demos", "export", "--tasks", "MoveToRegion", "--variants", "Demo", "--preset", "State", "--force")
    rollout = ("rollout", "MoveToRegion", "--policy", "random", "--episodes", "2", "--size", "64", "--force")
    minari = ("--to", "minari", "--out", "magical-mj/killed-v0")
    recordings = tuple(str(inputs / f"{seed}.json") for seed in range(8))
    demo = ("demo", "--tasks", "MoveToRegion", "--episodes", "1", "--jobs", "2", "--out", "{}")
    leaderboard = ("leaderboard", entry, "--jobs", "2", "--replay", "8", "--seed", "0", "--out", "{}")

    def whole(*command: str) -> Kind:
        """A command that writes all its files or none, and always the same files."""
        return Kind((*MAIN, *command), contents, contents)

    def reads(*command: str, code: int = 0) -> Kind:
        return Kind((*MAIN, *command), nothing, nothing, code)

    return {
        "evaluate": Kind((*MAIN, *EVALUATE, "--out", "{}"), lines, rows),
        "evaluate-shifts": Kind((*MAIN, *SHIFTED, "--shifts", "camera,slip", "--resume", "--out", "{}"), lines, rows),
        "rollout": whole(*rollout, "--video", "{}/a.mp4"),
        "view": whole("view", "--grid", "--size", "16", "--out", "{}/a.png", "--force"),
        "export": whole("export", "FindDupe", "All", "--out", "{}", "--force"),
        "report": Kind((*MAIN, "report", scores, "--out", "{}"), pages, pages),
        "compare": reads("compare", scores, scores),
        "verify": reads("verify", scores, "--jobs", "2", code=1),  # the evaluation is incomplete
        "submit": whole("submit", scores, "--out", f"{{}}/{ENTRY}"),
        "leaderboard": whole(*leaderboard),
        "list": reads("list"),
        "doctor": reads("doctor"),
        "inspect": Kind((*MAIN, "inspect", "FindDupe", "--port", "0"), nothing, None),
        "demo": Kind((*MAIN, *demo), nothing, rows),  # it replaces an earlier tour
        "generate": Kind((*MAIN, *generate, "--out", "{}"), demonstrations, demonstrations),
        "demos-rollouts": Kind((*MAIN, *rollouts, "--out", "{}"), demonstrations, demonstrations),
        "import": Kind((*MAIN, "demos", "import", *recordings, "--out", "{}"), demonstrations, demonstrations),
        "demos-info": reads("demos", "info", *chosen),
        "demos-verify": reads("demos", "verify", *chosen, "--jobs", "2"),
        "demos-video": whole("demos", "video", "--tasks", "FixColour", "--count", "1", "--out", "{}/a.mp4", "--force"),
        "demos-npz": whole(*export, "--out", "{}/a.npz"),
        "demos-minari": Kind(("env", "MINARI_DATASETS_PATH={}", *MAIN, *export, *minari), contents, contents),
        "demos-webdataset": whole(*export, "--to", "webdataset", "--out", "{}/a.tar"),
        "demos-xirl": whole(*export[:-1], "--to", "xirl", "--out", "{}/a"),
        "demos-robomimic": whole(*export, "--to", "robomimic", "--out", "{}/a.hdf5"),
        "play": Kind((sys.executable, "-c", PLAYER, *play), demonstrations, None),
        "play-web": Kind((*MAIN, "collect", "{}", "--port", "0"), nothing, None),
        "scenes": Kind((sys.executable, "-c", SAMPLER, "{}"), scenes, None),
        "train-bc-state": train("bc", ("--preset", "State"), *STATES, "bc.batches=800"),
        "train-bc": train("bc", ("--quick",), *PICTURES, "bc.batches=32", "bc.batch_size=8"),
        "train-gail": train("gail", ("--quick",), *PICTURES, *GAIL),
        "train-al": train("al", ("--quick",), *PICTURES, *AL),
        "train-airl": train("airl", ("--preset", "State"), *STATES, *GAIL),
        "train-iq-learn": train("iq-learn", ("--preset", "State"), *STATES, "bc.batches=400"),
        "train-relational": train("relational", ("--preset", "State"), *RELATIONAL),
        "export-policy": whole("export-policy", str(inputs / "run"), "--out", "{}/a.onnx", "--force"),
        "experiment": Kind((*MAIN, "experiment", str(inputs / "e.toml"), "--jobs", "2", "--out", "{}"), lines, rows),
    }


def kill(kind: Kind, name: str, folder: Path, kills: int, rng: random.Random) -> Counter[str]:
    """Kills a command many times, then lets it end, and checks its results.

    Returns:
        The number of times that each signal reached it.

    Raises:
        SystemExit: if a result was lost or changed.
    """
    expected, seconds = None, PLAYING
    if kind.result is not None:
        start = time.monotonic()
        undisturbed(kind, folder / "undisturbed")
        seconds = time.monotonic() - start
        expected = kind.result(folder / "undisturbed")
    out, landed, most = folder / "killed", Counter[str](), 0
    for number in range(TRIES * kills):
        if landed.total() == kills:
            break
        before = kind.finished(out)
        sent = SIGNALS[landed.total() % len(SIGNALS)]  # the same signal again if the command had ended before it
        start = time.monotonic()
        how, reached, ended = killed(kind, out, rng.uniform(0, seconds), sent, rng)
        now = kind.finished(out)
        lost = [result for result in before if now.get(result) != before[result]]
        if lost:
            raise SystemExit(f"{name}, {how}: lost or changed: {', '.join(lost)}")
        print(f"{name} {number}: {how}; {len(now) - len(before)} more, {len(now)} in all", flush=True)
        landed[sent.name] += reached
        most = max(most, len(now))
        if ended and kind.result is not None:
            seconds = seconds if reached else min(seconds, time.monotonic() - start)
            compare(name, kind.result(out), expected)
        if ended or (kind.finished is contents and "--force" not in kind.command):  # they refuse existing files
            shutil.rmtree(out, ignore_errors=True)
    if kind.result is not None:
        undisturbed(kind, out)
        compare(name, kind.result(out), expected)
    elif kind.finished is not nothing and not most:
        raise SystemExit(f"{name} has finished no result between {kills} kills; raise --kills")
    return landed


def compare(name: str, found: Found, expected: Found | None) -> None:
    """Ends the program if the results differ from those of a run without interruptions."""
    if expected is None or found.keys() != expected.keys():
        raise SystemExit(f"{name}: found {sorted(found)} instead of {sorted(expected or ())}")
    differing = [result for result in found if found[result] != expected[result]]
    if differing:
        raise SystemExit(f"{name}: different from a run without interruptions: {', '.join(differing)}")


def undisturbed(kind: Kind, out: Path) -> None:
    """Runs a command to its end."""
    result = subprocess.run(kind.into(out), capture_output=True, text=True, check=False, env=variables())
    if result.returncode != kind.code:
        raise SystemExit(f"{' '.join(kind.into(out))}: {result.stderr}")


def killed(kind: Kind, out: Path, moment: float, sent: signal.Signals, rng: random.Random) -> tuple[str, bool, bool]:
    """Starts a command, and sends it a signal after `moment` seconds.

    Returns:
        A description, whether the signal reached it, and whether it ended normally nevertheless.
    """
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            kind.into(out), start_new_session=True, env=variables(), stdout=subprocess.DEVNULL, stderr=errors
        )
        time.sleep(moment)
        reached = process.poll() is None
        if reached:
            process.send_signal(sent)  # only to the process: its workers must notice by themselves
        if reached and sent is signal.SIGSTOP:
            if whole_group := rng.random() < 0.5:  # as Ctrl-Z does
                os.killpg(process.pid, sent)
            time.sleep(PAUSE)
            (os.killpg if whole_group else os.kill)(process.pid, signal.SIGCONT)
            if kind.result is None:
                time.sleep(PAUSE)
                process.kill()
        code = process.wait()
        start = time.monotonic()
        while left := session(process.pid):
            if time.monotonic() - start > PATIENCE:
                raise SystemExit(f"{sent.name} after {moment:.1f} s left processes: {left}")
            time.sleep(0.05)
        errors.seek(0)
        if "Traceback" in (text := errors.read()):
            raise SystemExit(f"{kind.command} printed a traceback for {sent.name} after {moment:.1f} s: {text}")
    ended = kind.result is not None and (not reached or sent is signal.SIGSTOP)
    if (ended and code != kind.code) or (not reached and kind.result is None):
        raise SystemExit(f"{' '.join(kind.into(out))} ended with {code}: {text}")
    gone = f"all processes ended {time.monotonic() - start:.1f} s later"
    return f"{sent.name} after {moment:.1f} s, {gone}" if reached else "had ended before", reached, ended


def session(leader: int) -> list[int]:
    """The running processes of a session."""
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
    """The environment variables of each command: no visible windows, and deterministic sums."""
    return os.environ | {"SDL_VIDEODRIVER": "dummy", "OMP_NUM_THREADS": "1"}


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20, help="kills of each command")
    parser.add_argument("--kinds", default="all", help="the names of the commands, separated by commas")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells set it to ignore in background processes
    with tempfile.TemporaryDirectory() as name:
        inputs, every = Path(name) / "inputs", kinds(Path(name) / "inputs")
        chosen = list(every) if arguments.kinds == "all" else arguments.kinds.split(",")
        if unknown := set(chosen) - set(every):
            parser.error(f"unknown kinds {', '.join(unknown)}; the kinds are {', '.join(every)}")
        inputs.mkdir()
        prepare(inputs)
        landed, failed = dict[str, Counter[str]](), dict[str, SystemExit]()
        for kind in chosen:
            folder = Path(name) / kind
            folder.mkdir()
            try:
                rng = random.Random(f"{arguments.seed} {kind}")  # noqa: S311  no secret
                landed[kind] = kill(every[kind], kind, folder, arguments.kills, rng)
            except SystemExit as error:
                failed[kind] = error
                print(f"{kind} FAILED: {error}", flush=True)
    print("\n| command | " + " | ".join(sent.name for sent in SIGNALS) + " |")
    print("| --- |" + " ---: |" * len(SIGNALS))
    for kind, counts in landed.items():
        print(f"| {kind} | " + " | ".join(str(counts[sent.name]) for sent in SIGNALS) + " |")
    total = sum(counts.total() for counts in landed.values())
    print(f"{total} signals reached {len(landed)} commands; no result lost, no process left, equal final results")
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
