"""Videos of episodes: views side by side, and below them the current action and the score so far."""

from __future__ import annotations

import errno
import logging
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from magical_mj.actions import ACTIONS
from magical_mj.evaluation.replay import engine_for, other_scene
from magical_mj.evaluation.scores import SCORE_TOLERANCE, EpisodeResult
from magical_mj.observations import CAMERAS
from magical_mj.policies.interface import actions_of, play_actions
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks.registry import listed
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, check_name
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    from magical_mj.engine import Engine

Picture = NDArray[np.uint8]

SIDE_BY_SIDE: Final = ("allo", "ego")
"""The default views: from above, and from the robot."""
PAPER: Final = (255, 255, 255)
INK: Final = (60, 60, 60)
TITLE_SHADE: Final = (255, 255, 255, 225)  # RGBA of the band behind a title
SMALLEST_TEXT: Final = 8  # pixels
PAUSE: Final = 1  # seconds; an episode's first and last frame are shown this long
UNUSABLE: Final = re.compile(r'[/\\:*?"<>|\x00-\x1f]')
"""Characters that file names cannot contain on some systems."""
REPORT_SIZE: Final = 192  # pixels; of the videos in reports
REPORT_SPEED: Final = 4  # times real time


class Film:
    """Makes the frames of episodes, shape (height, width, 3), and passes each to `send`.

    They show `views` of `size` pixels, from left to right. The first and the last frame of an episode are repeated
    `pause` times. The height is even, as the video format requires.
    """

    def __init__(self, send: Callable[[Picture], object], size: int, views: Sequence[str], pause: int) -> None:
        self._send, self.size, self.views, self._pause = send, size, views, pause
        text = max(SMALLEST_TEXT, size // 24)
        self._line = round(1.4 * text)
        self._font, self._title_size = ImageFont.load_default(text), 2 * text
        self.width, self.height = len(views) * size, (size + 2 * self._line + self._line // 2 + 1) // 2 * 2
        self._title, self.frames = "", 0

    def begin(self, title: str, views: Picture, score: float) -> None:
        """Starts an episode: its first frame is shown for a moment with a title. `views`: shape (size, width, 3)."""
        self._title = title
        self._last = self._frame(views, "", score)
        frame = self._last.copy()
        band = Image.new("RGBA", (self.width, 4 * self._line), TITLE_SHADE)
        pen, size = ImageDraw.Draw(band), self._title_size
        while size > SMALLEST_TEXT and pen.textlength(title, ImageFont.load_default(size)) > self.width - self._line:
            size -= 1
        pen.text((self.width / 2, 2 * self._line), title, INK, ImageFont.load_default(size), anchor="mm")
        frame.paste(band, (0, (self.size - band.height) // 2), band)
        self._repeat(frame, self._pause)

    def add(self, views: Picture, step: int, action: int | NDArray[Any], score: float) -> None:
        """Adds the frame after an action."""
        self._last = self._frame(views, f"step {step}   {in_words(action)}", score)
        self._repeat(self._last, 1)

    def end(self) -> None:
        """Ends an episode: its last frame is shown for a moment."""
        self._repeat(self._last, self._pause)

    def _frame(self, views: Picture, doing: str, score: float) -> Image.Image:
        frame = Image.new("RGB", (self.width, self.height), PAPER)
        frame.paste(Image.fromarray(views), (0, 0))
        pen, margin, top = ImageDraw.Draw(frame), self._line // 2, self.size + self._line // 4
        pen.text((margin, top), self._title, INK, self._font)
        pen.text((margin, top + self._line), doing, INK, self._font)
        pen.text((self.width - margin, top + self._line), f"score {score:.2f}", INK, self._font, anchor="ra")
        return frame

    def _repeat(self, frame: Image.Image, times: int) -> None:
        picture = np.asarray(frame)
        for _ in range(times):
            self._send(picture)
        self.frames += times


@contextmanager
def film(
    path: Path, size: int, speed: int = 1, views: Sequence[str] = SIDE_BY_SIDE, *, overwrite: bool
) -> Iterator[Film]:
    """A context that makes a video of episodes at `speed` times real time, with views of `size` pixels side by side.

    If the block raises an error, the video is removed. An OSError if the file cannot be written.
    """
    check_extra("videos", "video")
    import imageio_ffmpeg

    logging.getLogger("imageio_ffmpeg").setLevel(logging.ERROR)  # it warns about videos without frames
    rate = speed * CONTROL_RATE
    failed = OSError(errno.EIO, "the video cannot be written; is the disk full?", str(path))

    def send(picture: Picture) -> None:
        try:
            writer.send(np.ascontiguousarray(picture))
        except OSError as error:  # ffmpeg has ended and closed the pipe
            raise failed from error

    with files.new_file(path, overwrite=overwrite) as unfinished:
        file = str(unfinished.absolute())  # ffmpeg takes "a:b.mp4" for a protocol
        movie = Film(send, size, views, pause=PAUSE * rate)
        writer = imageio_ffmpeg.write_frames(
            file, (movie.width, movie.height), fps=rate, macro_block_size=2, quality=8, ffmpeg_log_level="quiet"
        )
        with closing(writer):
            writer.send(None)
            yield movie
        with suppress(RuntimeError):  # it has no frames at all
            if imageio_ffmpeg.count_frames_and_secs(file)[0] == movie.frames:
                return
        raise failed  # frames are missing, but ffmpeg reported no error


def replay(movie: Film, score: EpisodeResult, renderer: str | None = None) -> None:
    """Replays the actions of an evaluated episode, and adds it to a video, drawn by `renderer`.

    It must have no `obstacle`: its names are resolved here. If its scene or its score differs from the record, an
    `EvaluationError` is raised.
    """
    environment = " ".join(filter(None, (score.task, score.variant, score.shift)))
    title = f"{environment}, seed {score.seed}: {score.policy}"
    with closing(engine_for(score, renderer)) as env:
        if problem := other_scene(score, env):
            raise EvaluationError(f"{title} cannot be filmed: {problem}")
        movie.begin(title, side_by_side(env, movie.size, movie.views), env.score())
        for step, (action, _) in enumerate(play_actions(env, actions_of(score.actions)), start=1):
            movie.add(side_by_side(env, movie.size, movie.views), step, action, env.score())
        movie.end()
        ending = env.score()
    if score.failure is None and abs(ending - score.score) > SCORE_TOLERANCE:
        raise EvaluationError(
            f"{title} ends with {ending:.2f} now, not {score.score:.2f}: "
            f"it was played with magical_mj {score.version} and MuJoCo {score.mujoco}"
        )


def views_of(cameras: str) -> list[str]:
    """The views of an option "--camera"."""
    views = listed(cameras, CAMERAS)
    for view in views:
        check_name("view", view, CAMERAS)
    return views


def side_by_side(env: Engine, size: int, views: Sequence[str] = SIDE_BY_SIDE) -> Picture:
    """Views of the current state side by side. Shape (size, views * size, 3)."""
    return np.concatenate([env.render(view, size) for view in views], axis=1)


def in_words(action: int | NDArray[Any]) -> str:
    """An action in words, such as "forward, left, grip"; "nothing" for the no-op. Continuous actions are numbers."""
    if isinstance(action, np.ndarray) and action.ndim:
        names = ("speed", "turn", "grip")
        return ", ".join(f"{name} {value:.2f}" for name, value in zip(names, action, strict=False))
    gripper, turn, drive = ACTIONS[int(action)]
    words = [direction.name.lower() for direction in (drive, turn) if direction]
    return ", ".join(words + ["grip"] * gripper) or "nothing"


def by_file_name(episodes: Iterable[tuple[str, EpisodeResult]]) -> dict[str, tuple[str, EpisodeResult]]:
    """The episodes by the names of the videos that `film_episodes` makes."""
    named: dict[str, tuple[str, EpisodeResult]] = {}
    for which, score in episodes:
        name = UNUSABLE.sub("-", f"{which}-{score.method}-{score.task}.mp4")
        named[f"{len(named)}-{name}" if name in named else name] = which, score  # methods a/b and a-b are the same here
    return named


def film_episodes(
    episodes: Sequence[tuple[str, EpisodeResult]], out: Path, renderer: str | None = None
) -> dict[str, str]:
    """Makes a video of each episode. Episodes are pairs such as ("best", episode). Returns description -> file name."""
    links: dict[str, str] = {}
    for name, (which, score) in by_file_name(episodes).items():
        with film(out / name, REPORT_SIZE, REPORT_SPEED, overwrite=True) as movie:
            replay(movie, score, renderer)
        about = f"{score.variant}, seed {score.seed}, score {score.score:.2f}"
        links[f"{score.method}, {which} of {score.task}: {about}"] = name
    return links
