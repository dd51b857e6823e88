"""What the page is told, and the server behind it: real processes, real sockets."""

from __future__ import annotations

import asyncio
import io
import json
import re
import signal
import socket
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

import magical_mj
from magical_mj import demos
from magical_mj.demos.recording import Recorder
from magical_mj.policies.interface import actions_of
from magical_mj.protocol import PROTOCOL
from magical_mj.utils.errors import SettingsError
from magical_mj.web.collection import Collection
from magical_mj.web.page_data import PAGE, catalogue, environment_scenes, scene_data, sections
from magical_mj.web.study import Study, read_study
from tests.helpers.commands import Shell

websockets = pytest.importorskip("websockets")

from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import ClientConnection, connect  # noqa: E402

from magical_mj.web.inspection import model_files  # noqa: E402
from magical_mj.web.puzzles import goal_data, puzzle_of  # noqa: E402
from magical_mj.web.server import PlayerSession, PlayServer, poses  # noqa: E402


@pytest.fixture(autouse=True)
def _no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The user's proxy does not know this machine's servers."""
    monkeypatch.setenv("no_proxy", "127.0.0.1,localhost,::1")


def test_the_page_is_told_of_every_task_in_words_and_with_a_solved_example() -> None:
    contents = json.loads(json.dumps(catalogue(magical_mj.ENVIRONMENTS, "browser")))
    assert set(contents["tasks"]) == set(magical_mj.TASKS)
    for task, facts in contents["tasks"].items():
        solved = magical_mj.Scene.from_json(json.dumps(facts["solved"]))
        assert magical_mj.score(task, magical_mj.sample_scene(task, "Demo", 0), solved) == 1.0
        assert facts["hint"].endswith(".")
        parts = sections(task)
        assert {"Summary", "Goal", "What varies", "Score", "Differences from the original"} <= set(parts)
        assert all(parts.values())


def test_outlines_have_their_sizes_and_layers() -> None:
    look = catalogue(magical_mj.ENVIRONMENTS[:1], "browser")["look"]
    square = look["blocks"]["square"][0][0]
    assert max(square) == pytest.approx(magical_mj.scene.constants.SQUARE_SIDE / 2, abs=1e-6)
    parts = {body: [layer["part"] for layer in layers] for body, layers in look["robots"].items()}
    assert parts["gripper"][-1] != "left_finger"  # the body hides the fingers' roots
    assert set(parts["gripper"]) >= {"left_finger", "right_finger"}
    assert set(parts["longstick"]) == {"face"}
    assert set(look["blocks"]) == set(magical_mj.scene.constants.SHAPES)
    assert all(len(layers) == 2 for layers in look["arenas"].values())  # beyond the walls, and the line between
    assert all(len(layers) == 2 for layers in look["blocks"].values())


def test_the_expert_that_is_watched_solves_the_scenes() -> None:
    for number, (task, variant) in enumerate(magical_mj.ENVIRONMENTS[::3]):
        entries = environment_scenes(task, variant)["scenes"]
        assert len(entries) == (1 if variant == "Demo" else 20)
        entry = entries[number % len(entries)]
        env = magical_mj.Engine(task, variant, seed=entry["seed"])
        env.reset()
        for action in actions_of(entry["expert"]):
            env.step(action)
        assert env.score() == 1.0, (task, variant)
        env.close()


def recording(task: str, variant: str, seed: int, actions: list[int]) -> dict[str, Any]:
    return {"format": 1, "protocol": PROTOCOL, "task": task, "variant": variant, "seed": seed, "actions": actions}


class Clock:
    """A time that tests move."""

    def __init__(self) -> None:
        self.now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


def played(offer: dict[str, Any], actions: list[int] | None = None) -> str:
    """The recording of an episode in the scene that was offered; without actions, one that nobody else plays."""
    env = magical_mj.Engine(offer["task"], offer["variant"], seed=offer["seed"])
    actions = [1 + offer["seed"] % 2] * (env.horizon or 0) if actions is None else actions
    for action in actions:
        env.step(action)
    text = json.dumps({**recording(env.task, env.variant, offer["seed"], actions), "final": poses(env.scene)})
    env.close()
    return text


def test_a_study_keeps_its_quotas_and_counts_an_episode_once(tmp_path: Path) -> None:
    clock = Clock()
    study = Study(
        {"MoveToRegion-Demo": 1, "MoveToRegion-Layout": 1}, consent="Your actions are stored.", lease_minutes=10
    )
    collection = Collection(tmp_path, study, clock, clock)
    ann, ben, eve = (collection.participant(None) for _ in range(3))
    assert collection.participant("../../somewhere") not in ("../../somewhere", ann)
    assert collection.participant(ann) == ann
    assert collection.next(ann) == {"next": None, "consent": study.consent}
    for person in (ann, ben, eve):
        collection.agree(person)
    first, second = collection.next(ann)["next"], collection.next(ben)["next"]
    assert (first["variant"], second["variant"]) == ("Demo", "Layout")
    assert collection.next(ann)["next"] == first, "a reload, or another tab"
    for person, scene in ((ann, first), (ben, second)):
        collection.begin(person, (scene["task"], scene["variant"], scene["seed"]))
    assert "come back later" in collection.next(eve)["why"]
    with pytest.raises(magical_mj.utils.errors.DemonstrationError, match="not offered"):
        collection.keep(played(first), eve, {})
    with pytest.raises(magical_mj.utils.errors.DemonstrationError, match="its final state"):
        collection.keep(json.dumps({**json.loads(played(first)), "final": None}), ann, {})
    score = collection.keep(played(first), ann, {"speed": 1, "watched": False})
    assert collection.keep(played(first), ann, {}) == score, "the first answer was lost"
    clock.now += 11 * 60
    assert collection.next(eve)["next"] == second, "whoever left loses the scene"
    collection.begin(eve, (second["task"], second["variant"], second["seed"]))
    with pytest.raises(magical_mj.utils.errors.DemonstrationError, match="too late"):
        collection.keep(played(second), ben, {})
    again = Collection(tmp_path, study, clock, clock)  # as after a kill
    assert again.next(eve)["next"] == second
    again.keep(played(second), eve, {"speed": 1, "watched": True})
    assert "enough" in again.next(ben)["why"]
    status = again.status()
    assert [(row["accepted"], row["leased"]) for row in status["environments"]] == [(1, 0), (1, 0)]
    assert status["environments"][0]["refused"] == {
        "this scene was not offered to you": 1,
        "it does not contain its final state": 1,
    }
    assert len(list(tmp_path.rglob("*.npz"))) == 2
    clock.now -= 11 * 60
    with pytest.raises(magical_mj.utils.errors.DemonstrationError, match="enough"):
        again.keep(played(second, [3] * 40), ben, {})  # who seems to be in time again
    log = [json.loads(line) for line in (tmp_path / "study.jsonl").read_text().splitlines()]
    assert [event["watched"] for event in log if event["event"] == "accepted"] == [False, True]


def test_a_study_has_practice_a_least_score_and_a_code(tmp_path: Path) -> None:
    study = Study({"MoveToRegion-Demo": None}, practice=1, least_score=1.0, episodes=1, completion_code="CODE-7")
    collection = Collection(tmp_path, study)
    me = collection.participant(None)
    practice = collection.next(me)["next"]
    assert practice["practice"]
    assert (practice["number"], practice["of"]) == (1, 1)
    collection.keep(played(practice), me, {})
    offer = collection.next(me)["next"]
    assert not offer["practice"]
    with pytest.raises(magical_mj.utils.errors.DemonstrationError, match=r"0\.00 is lower than 1\.00"):
        collection.keep(played(offer, [0] * 40), me, {})
    assert collection.next(me)["next"] == offer
    solved = demos.load("MoveToRegion")[0].actions.tolist()
    assert collection.keep(played(offer, solved), me, {}) == 1.0
    assert collection.next(me)["code"] == "CODE-7"
    other = collection.participant(None)
    collection.keep(played(collection.next(other)["next"]), other, {})
    with pytest.raises(magical_mj.utils.errors.DemonstrationError, match="sent earlier"):
        collection.keep(played(collection.next(other)["next"], solved), other, {})
    collection.pause(True)
    assert "paused" in Collection(tmp_path, study).next(collection.participant(None))["why"]
    assert len(list(tmp_path.rglob("*.npz"))) == 1


def test_a_damaged_folder_of_a_study_is_reported(tmp_path: Path) -> None:
    study = Study({"MoveToRegion-Demo": 3})
    collection = Collection(tmp_path, study)
    collection.next(collection.participant(None))
    log = tmp_path / "study.jsonl"
    with log.open("ab") as file:
        file.write(b'{"time": 1, "event": "off')  # a kill in between
    again = Collection(tmp_path, study)
    again.next(again.participant(None))
    assert log.read_bytes().count(b"\n") == 2
    assert log.read_bytes().endswith(b"}\n")
    log.write_bytes(b"nonsense\n")
    with pytest.raises(magical_mj.utils.errors.SettingsError, match="line 1 of"):
        Collection(tmp_path, study)
    log.unlink()
    assert (collection.token(), collection.token()) == (collection.token(),) * 2
    assert collection.token("operator") != collection.token()
    assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600
    for damaged in (b"", b"\xff\xfe", b"a/b"):
        (tmp_path / "token").write_bytes(damaged)
        with pytest.raises(magical_mj.utils.errors.SettingsError, match="delete it"):
            collection.token()
    (tmp_path / "0123456789abcdef").mkdir()
    (tmp_path / "0123456789abcdef" / "MoveToRegion-Demo-human-000.npz").touch()
    with pytest.raises(magical_mj.utils.errors.DemonstrationError, match="damaged"):
        Collection(tmp_path, study)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("title = 'x'", "missing required field `environments`"),
        ("[environments]", "must be from the benchmark"),
        ("[environments]\nTetris-Demo = 1", "Tetris-Demo"),
        ("least_score = 2.0\n[environments]\nFindDupe-Demo = 1", "least_score"),
        ("color = 1\n[environments]\nFindDupe-Demo = 1", "color"),
    ],
)
def test_a_wrong_study_file_is_explained(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(magical_mj.utils.errors.SettingsError, match=re.escape(complaint)):
        read_study(tmp_path / "study.toml")


@pytest.mark.parametrize(
    ("host", "port", "origin", "start"),
    [
        ("127.0.0.1", 8008, None, "http://127.0.0.1:8008"),
        ("127.0.0.1", 80, None, "http://127.0.0.1"),
        ("0.0.0.0", 8080, None, "http://localhost:8080"),
        ("::1", 8008, None, "http://[::1]:8008"),
        ("::1", 80, None, "http://[::1]"),
        ("::1", 8008, "https://study.example.org:443", "https://study.example.org"),
        ("::1", 8008, "http://study.example.org:80", "http://study.example.org"),
        ("::1", 8008, "https://study.example.org:80", "https://study.example.org:80"),
    ],
)
def test_addresses_are_written_as_browsers_do(host: str, port: int, origin: str | None, start: str) -> None:
    assert PlayServer(magical_mj.ENVIRONMENTS[:1], host, port, "secret", origin).address == f"{start}/secret/"


def test_an_ipv6_address_is_played_at() -> None:
    def visit(address: str) -> Any:
        with sit(address) as seat:
            return ask(seat, {"dance": 1})

    async def play() -> Any:
        server = PlayServer(magical_mj.ENVIRONMENTS[:1], "::1", 0)
        async with await server.start():
            return await asyncio.to_thread(visit, server.address)

    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("there is no IPv6 here")
    assert "error" in asyncio.run(play())


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["play"], "Missing argument"),
        (["serve", "--tasks", "Tetris"], "Tetris"),
        (["serve", "FindDupe", "--tasks", "MakeLine"], "not among"),
        (["serve", "FindDupe", "--seed", str(2**53)], "seeds in a browser are at most 9007199254740991"),
        (["serve", "--seed", "5"], "--seed has an effect only with TASK"),
        (["serve", "--origin", "https://[bad"], "such as https://study.example.org"),
        (["collect", "out", "--port", "99999"], "port"),
        (["collect", "out", "--study", "study.toml", "--wanted", "3"], "the study sets it"),
    ],
)
def test_wrong_options_are_explained(options: list[str], complaint: str, shell: Shell) -> None:
    assert complaint in shell.fails(2, *options)


def test_an_unusable_host_or_port_is_an_error(shell: Shell) -> None:
    assert "give another --host" in shell.fails(1, "serve", "--host", "127..0.0.1")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        error = shell.fails(1, "serve", "--port", taken.getsockname()[1])
    assert "cannot listen at this address" in error
    assert "--port 0" in error


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[subprocess.Popen[str], str, Path]]:
    """The process, the page's address and the folder in which it collects."""
    folder = tmp_path_factory.mktemp("collected")
    study = folder.parent / "study.toml"
    study.write_text('shows = ["scenes"]\n[environments]\nMoveToRegion-All = 3\nFindDupe-Demo = 3\n')
    command = [sys.executable, "-m", "magical_mj", "collect", str(folder), "--study", str(study), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip(), folder
        process.kill()


def sit(address: str, origin: str | None = None) -> ClientConnection:
    own = address.rsplit("/", 2)[0]
    return connect(f"{address.replace('http', 'ws', 1)}socket", origin=own if origin is None else origin)


def ask(seat: ClientConnection, message: Any) -> Any:
    seat.send(json.dumps(message))
    return json.loads(seat.recv())


def test_requests_without_the_token_are_refused(server: tuple[Any, str, Path]) -> None:
    _, address, folder = server
    for wrong in (address[:-2] + "/", address[:-1], address.rsplit("/", 2)[0] + "/", f"{address}../pyproject.toml"):
        with pytest.raises(HTTPError, match=r"40[34]"):
            urlopen(wrong, timeout=60)
    for origin in ("http://evil.example", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            sit(address, origin)
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"{address.replace('http', 'ws', 1)}socket")  # without an origin
    with pytest.raises(InvalidStatus, match="403"):
        sit(address[:-3] + "xx/", address.rsplit("/", 2)[0])
    with sit(address) as seat:
        elsewhere = {"open": {"task": "MakeLine", "variant": "Demo", "seed": 0}}
        for message in ("act", {"act": 0}, {"act": 99}, elsewhere, {"dance": 1}, {"keep": {}}):
            assert "error" in ask(seat, message)
        seat.send("x" * 200_000)
        with pytest.raises(ConnectionClosed):
            seat.recv()
    assert sorted(path.name for path in folder.iterdir()) == ["operator", "token"]


def test_every_request_gets_a_status(server: tuple[Any, str, Path]) -> None:
    _, address, _ = server
    host, path = address.removeprefix("http://").split("/", 1)
    port = int(host.rpartition(":")[2])

    def answer(request: str, host: str = host) -> tuple[int, bytes]:
        with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
            connection.sendall(f"{request}\r\nHost: {host}\r\n\r\n".encode("latin-1"))
            reply = b"".join(iter(lambda: connection.recv(65536), b""))
        head, _, body = reply.partition(b"\r\n\r\n")
        return int(head.split()[1]), body

    page = (PAGE / "index.html").read_bytes()
    assert answer(f"GET /{path} HTTP/1.1") == (200, page)
    assert answer(f"HEAD /{path} HTTP/1.1") == (200, b"")
    assert answer(f"POST /{path} HTTP/1.1")[0] == 405
    for odd in ("/", "//", "*", "http://elsewhere.example/", "/%00", f"/../{path}", "?"):
        assert answer(f"GET {odd} HTTP/1.1")[0] == 403
    for odd in ("..%2ftoken", "scenes/..", "scenes/MakeLine-Demo.json", "token"):
        assert answer(f"GET /{path}{odd} HTTP/1.1")[0] == 404
    assert answer(f"GET /{path} HTTP/1.1", f"localhost:{port}")[0] == 200
    for other in ("rebound.example", f"rebound.example:{port}", f"127.0.0.1:{port}\r\nHost: localhost"):
        assert answer(f"GET /{path} HTTP/1.1", other)[0] == 421


def test_an_episode_at_the_server_is_pythons_and_outlives_a_kill(server: tuple[Any, str, Path]) -> None:
    """The last test of this server."""
    process, address, folder = server
    with urlopen(address, timeout=60) as reply:
        assert reply.read() == (PAGE / "index.html").read_bytes()
    env = magical_mj.Engine("MoveToRegion", "All", seed=0)
    env.reset()
    recorder, actions = Recorder(env), [1, 4, 7, 10] * 10
    with sit(address) as seat:
        arrived = ask(seat, {"arrive": None})
        opened = ask(seat, {"open": {"task": "MoveToRegion", "variant": "All", "seed": 0}})
        assert opened["scene"] == scene_data(env.scene)
        for action in actions:
            recorder.step(action)
            poses = ask(seat, {"act": action})["poses"]
        assert poses["robot"] == list(env.scene.robot.pose)
        mine = {**recording("MoveToRegion", "All", 0, actions), "final": poses}
        wrong = {**mine, "final": {**poses, "robot": [0.0, 0.0, 0.0]}}
        assert "away from the recorded state" in ask(seat, {"keep": wrong})["error"]
        assert ask(seat, {"keep": mine})["score"] == env.score()
        runs = f"{address.rsplit('/', 2)[0]}/{(folder / 'operator').read_text()}/"
        with sit(runs) as operator:
            assert ask(operator, {"status": True})["environments"][0]["accepted"] == 1
        with urlopen(f"{runs}operator.html", timeout=60) as reply:
            assert b"Run a study" in reply.read()
        (kept,) = demos.files_in(folder)
        kept.with_name(f".{kept.stem}.0123abcd-4567cdef.part.npz").write_bytes(b"left by a kill")
        with urlopen(f"{runs}demonstrations.zip", timeout=60) as reply:
            names = zipfile.ZipFile(io.BytesIO(reply.read())).namelist()
            assert names == [str(kept.relative_to(folder)), "study.jsonl"]
        for page in ("operator.html", "demonstrations.zip"):
            with pytest.raises(HTTPError, match="404"):
                urlopen(f"{address}{page}", timeout=60)
        assert "error" in ask(seat, {"status": True})
        with sit(address) as other:
            assert ask(other, {"return": arrived["participant"]}) == {"participant": arrived["participant"]}
            assert ask(other, {"keep": mine})["score"] == env.score(), "the same episode, which counts once"
        process.send_signal(signal.SIGKILL)
    process.wait()
    (path,) = demos.files_in(folder)
    assert path.parent.name == arrived["participant"]
    demo = demos.read(path)
    assert (demo.scene_seed, demo.demonstrator, demo.score) == (0, "human", env.score())
    assert demos.verify(demo).exact
    env.close()


def test_a_model_is_read_with_the_files_that_it_names(tmp_path: Path) -> None:
    for folder in ("shapes/m", "shapes/n"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "stone.obj").write_text(f"# of {folder}")
    (tmp_path / "secret.txt").write_text("not named")
    (tmp_path / "parts.xml").write_text(
        '<mujoco><compiler meshdir="shapes"/><asset><mesh file="m/stone.obj"/>'
        '<mesh file="./n/../n/stone.obj"/></asset></mujoco>'
    )
    model = tmp_path / "model.xml"
    model.write_text('<mujoco><include file="parts.xml"/><asset><mesh file="missing.obj"/></asset></mujoco>')
    contents = model_files(model)
    assert list(contents) == ["model.xml", "parts.xml", "shapes/m/stone.obj", "shapes/n/stone.obj"]
    assert contents["shapes/n/stone.obj"] == b"# of shapes/n", "files with one name in two folders are kept apart"
    model.write_text("<mujoco><broken")
    assert list(model_files(model)) == ["model.xml"]  # the page says what is wrong


def test_a_strangers_model_cannot_read_files_outside_of_its_folder(tmp_path: Path) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    own.mkdir()
    other.mkdir()
    (other / "secret.png").write_text("secret")
    (own / "link.png").symlink_to(other / "secret.png")
    (own / "folder").symlink_to(other)
    (own / "inner").mkdir()
    model = own / "model.xml"

    def read(text: str, *folders: Path) -> list[str]:
        model.write_text(f"<mujoco>{text}</mujoco>")
        return list(model_files(model, folders))

    texture = f'<asset><texture file="{other}/secret.png"/></asset>'
    for text in (
        '<include file="/etc/passwd"/>',
        '<asset><texture file="/proc/self/environ"/></asset>',
        '<asset><mesh file="../other/secret.png"/></asset>',
        '<compiler assetdir="../other"/><asset><mesh file="secret.png"/></asset>',
        '<asset><mesh file="inner/../../other/secret.png"/></asset>',
        '<asset><mesh file="link.png"/></asset>',
        '<asset><skin file="folder/secret.png"/></asset>',
        texture,
    ):
        with pytest.raises(SettingsError, match="not below its folder"):
            read(text)
    assert read(texture, other) == ["model.xml", f"{other}/secret.png"], "a folder that the user names"
    assert read('<asset><mesh file="../other/missing.stl"/></asset>') == ["model.xml"]
    (own / "inner" / "a.stl").write_text("a")
    assert read('<asset><mesh file="inner/../inner/a.stl"/></asset>') == ["model.xml", "inner/a.stl"]
    with pytest.raises(SettingsError, match="refers to more than 3,000 files"):
        read("".join(f'<include file="{number}.xml"/>' for number in range(4_000)))


def test_a_missing_model_is_named(shell: Shell) -> None:
    assert "nothing.xml: No such file" in shell.fails(1, "inspect", "nothing.xml")
    assert "only with TASK" in shell.fails(2, "inspect", "nothing.xml", "--seed", 2)


def test_an_intent_is_played_at_the_server_as_a_puzzle() -> None:
    puzzle = puzzle_of("intent:dev/14")
    session = PlayerSession((), puzzles={puzzle.name: puzzle})
    with closing(session):
        opened = json.loads(session.answer(json.dumps({"open": {"task": puzzle.name, "variant": "All", "seed": 77}})))
        scene = magical_mj.Scene.from_json(json.dumps(opened["scene"]))
        assert scene == magical_mj.sample_scene(puzzle.task, "All", 77)
        assert opened["goal"] == json.loads(json.dumps(goal_data(puzzle.intent, scene)))
        for refused in ("Diagnose", "Jitter"):
            asked = {"open": {"task": puzzle.name, "variant": refused, "seed": 0}}
            assert "is not available here" in json.loads(session.answer(json.dumps(asked)))["error"]
    server = PlayServer(magical_mj.ENVIRONMENTS[:1], token="secret", puzzles=[puzzle])
    catalogued = json.loads(server._content("catalogue.json") or b"")
    assert [pair["task"] for pair in catalogued["puzzles"]] == [puzzle.name] * 3
    data = json.loads(server._content(f"puzzles/{puzzle.name}-Layout.json") or b"")
    assert data["puzzle"]["sentence"] == puzzle.intent.sentence
    assert server._content(f"puzzles/{puzzle.name}-Jitter.json") is None
