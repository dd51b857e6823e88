"""A running study: it offers scenes to participants, checks the recordings, and stores them in one folder.

The folder contains a subfolder with the demonstrations of each participant, named by a random id; `study.jsonl`, with
a line for each offer, consent, answer to a question, and accepted or rejected recording; and the secret parts of two
addresses, `token` for participants and `operator` for the person who runs the study.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import re
import secrets
import sys
import threading
import time
import zipfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from magical_mj import demos
from magical_mj.demos.demonstration import SUFFIX, Demonstration
from magical_mj.tasks.registry import Pair
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, SettingsError, short_repr
from magical_mj.utils.lines import appending, read_lines
from magical_mj.web.asking import asked
from magical_mj.web.study import Study

_PARTICIPANT: Final = re.compile("[0-9a-f]{16}")
_TOKEN: Final = re.compile("[A-Za-z0-9_-]{16,}")
LOG: Final = "study.jsonl"
PRACTICE: Final = 1_000_000
"""The seed of the first scene for practice. Scenes with lower seeds count."""
TRIAL: Final = ".trial"
"""A file that is written to find out whether episodes can be saved again, and removed."""
ROOM: Final = 1_000_000
"""The size of that file in bytes. Demonstrations take 20,000."""
FULL: Final = "Episodes cannot be saved at present: please come back later, and inform the study's operator"
"""The message to participants after the disk was full, or failed."""
BINS: Final = 10
"""The number of bars in the histogram of scores."""


class Offer(NamedTuple):
    """A scene that is offered to a participant."""

    task: str
    variant: str
    seed: int
    until: float
    """The time of the study's timer until which it is valid."""
    began: bool
    """Whether the participant has acted in it. From then on it is reserved."""


class Collection:
    """A running study.

    Args:
        folder: the folder. It is created if it is missing; demonstrations that it already contains count.
        study: the study's settings.
        clock: returns the time in seconds since 1970, for the log and for the study's opening and closing.
        timer: returns a time in seconds that nobody sets, for the validity of offers.

    Raises:
        OSError: if the folder cannot be created, or read.
        DemonstrationError: if a demonstration in it is damaged.
        SettingsError: if a line of its `study.jsonl` is damaged.
    """

    def __init__(
        self,
        folder: Path,
        study: Study,
        clock: Callable[[], float] = time.time,
        timer: Callable[[], float] = time.monotonic,
    ) -> None:
        self.study = study
        self._folder, self._clock, self._timer, self._lock = folder, clock, timer, threading.Lock()
        self._quotas = study.pairs
        self._offers: dict[str, Offer] = {}
        self._addresses: dict[str, str] = {}
        self._consents: set[str] = set()
        self.questions = {question.id: question for question in asked(study.questions)} if study.questions else {}
        self._answered: defaultdict[str, set[str]] = defaultdict(set)
        self._practised: Counter[str] = Counter()
        self._accepted: dict[Pair, dict[int, float]] = {pair: {} for pair in self._quotas}
        self._counts: Counter[str] = Counter()
        self._refusals: dict[Pair, Counter[str]] = defaultdict(Counter)
        self._episodes: dict[str, tuple[str, float]] = {}
        self.paused = False
        self._saves = True
        folder.mkdir(parents=True, exist_ok=True)
        self._read()
        for task, variant in self._quotas:
            for path in sorted(folder.glob(f"*/{task}-{variant}-*{SUFFIX}")):
                self._count(path.parent.name, demos.read(path, task))

    def token(self, name: Literal["token", "operator"] = "token") -> str:
        """The secret part of the page's address. It stays the same when the server is restarted.

        Raises:
            OSError: if it cannot be saved.
            SettingsError: if its file has other content.
        """
        path = self._folder / name
        with suppress(FileExistsError):  # from an earlier run, or another process
            files.write(path, secrets.token_urlsafe(16), mode=0o600)
        token = path.read_text(encoding="ascii", errors="replace").strip()
        if not _TOKEN.fullmatch(token):
            raise SettingsError(f"{path} must contain the secret part of the address; delete it to create a new one")
        return token

    def participant(self, name: Any) -> str:
        """The id `name` of a returning participant, if it has the form of an id; otherwise a new id."""
        return name if isinstance(name, str) and _PARTICIPANT.fullmatch(name) else secrets.token_hex(8)

    def agree(self, participant: str, address: str = "") -> None:
        """Records that a participant, who can get a scene, has agreed to the consent text, with the text's hash."""
        with self._lock:
            new = participant not in self._consents and self._closed(participant, address) is None
            if self.study.consent and new:
                digest = hashlib.sha256(self.study.consent.encode()).hexdigest()
                self._note({"event": "consent", "participant": participant, "sha256": digest})

    def next(self, participant: str, address: str = "") -> dict[str, Any]:
        """The participant's next scene, as data for the page.

        For the first of four episodes, `{"next": {"task": ..., "variant": ..., "seed": ..., "practice": bool,
        "number": 1, "of": 4}}`. Without a limit, `of` is None. If no scene can be offered now, `next` is None, and
        `why` gives the reason. If the participant must first agree to a text, `{"next": None, "consent": text}`.

        Args:
            participant: the participant's id.
            address: the network address, which is not stored; "" if it is unknown.

        Raises:
            OSError: if the offer cannot be saved.
        """
        with self._lock:
            if why := self._closed(participant, address):
                return {"next": None, **why}
            if self.study.consent and participant not in self._consents:
                return {"next": None, "consent": self.study.consent}
            offer, now = self._offers.get(participant), self._timer()
            if offer is None or not self._holds(participant, offer):
                offer = self._choose(participant)
            if offer is None:
                return {"next": None, "why": "All remaining scenes are being played by others: please come back later"}
            if offer != self._offers.get(participant) or offer.until - now < 30 * self.study.lease_minutes:
                self._offer(participant, offer)
            self._addresses[participant] = address
            task, variant, seed, *_ = offer
            practice = seed >= PRACTICE
            number = 1 + (self._practised if practice else self._counts)[participant]
            count = {"number": number, "of": self.study.practice if practice else self.study.episodes}
            return {"next": {"task": task, "variant": variant, "seed": seed, "practice": practice, **count}}

    def begin(self, participant: str, scene: tuple[str | None, str, int | None]) -> None:
        """Reserves an offered scene for a participant, who acts in it for the first time. Other scenes are ignored.

        `scene` are its task, variant and seed.

        Raises:
            DemonstrationError: if others have reserved all scenes that are still needed, or nothing can be saved.
            OSError: if this cannot be saved.
        """
        with self._lock:
            offer = self._offers.get(participant)
            if offer is None or offer.began or offer[:3] != scene:
                return
            if not self._can_save():
                raise DemonstrationError(f"{FULL}; reload the page then")
            if not self._holds(participant, offer):
                raise DemonstrationError("others play all remaining scenes by now: reload the page")
            self._offer(participant, offer._replace(began=True))

    def offered(self, participant: str | None, task: str, variant: str, seed: int) -> bool:
        """Whether this participant may open a scene."""
        offer = self._offers.get(participant or "")
        return "scenes" in self.study.shows or (offer is not None and offer[:3] == (task, variant, seed))

    def keep(self, recording: str, participant: str, about: Mapping[str, Any]) -> float:
        """Replays a recording, and saves it as a demonstration before it returns. A repeated recording counts once.

        Args:
            recording: the text of the recording.
            participant: the participant's id.
            about: how it was played: `speed`, a factor of real time, and `watched`, whether the expert was shown
                before.

        Returns:
            Its score.

        Raises:
            MagicalError: if it does not count. The message gives the reason.
            OSError: if it cannot be saved.
        """
        demo, deviation, suspect = demos.from_recording(recording)
        pair, key = (demo.task, demo.variant), _key(demo)
        with self._lock:
            if self._episodes.get(key, ("", 0.0))[0] == participant:  # the answer to the first message was lost
                return self._episodes[key][1]
            offer = self._offers.get(participant)
            facts = {"participant": participant, "task": demo.task, "variant": demo.variant, "seed": demo.scene_seed}
            facts |= {"score": demo.score, "speed": _number(about.get("speed"))}
            facts["watched"] = about.get("watched") is True
            reason = None
            if deviation is None:
                reason = "it does not contain its final state"
            elif suspect:
                reason = f"its replay ends {deviation:.3g} away from the recorded state: reload the page"
            elif offer is None or offer[:3] != (*pair, demo.scene_seed):
                reason = "this scene was not offered to you"
            elif key in self._episodes:
                reason = "the same episode was sent earlier"
            elif demo.scene_seed < PRACTICE and not self._holds(participant, offer):
                reason = "it came too late, and the study has enough by now"
            elif demo.scene_seed < PRACTICE and demo.score < self.study.least_score:
                reason = f"its score {demo.score:.2f} is lower than {self.study.least_score:.2f}: please try again"
            if reason is not None:
                self._note({"event": "refused", "reason": reason.partition(":")[0], **facts})
                raise DemonstrationError(f"this episode does not count: {reason}")
            if demo.scene_seed >= PRACTICE:
                self._note({"event": "practised", **facts})
            else:
                with self._saving():
                    demos.keep(demo, self._folder / participant)
                self._note({"event": "accepted", **facts})
                self._count(participant, demo)
            return demo.score

    def answered(self, participant: str) -> dict[str, list[str]]:
        """The ids of the questions that a participant has answered, as data for the page."""
        return {"answered": sorted(self._answered[participant])}

    def answer(self, participant: str, question: str, letter: str, seconds: Any) -> dict[str, list[str]]:
        """Records a participant's answer to a question. Only the first answer to each counts.

        Returns:
            The value of `answered`.

        Raises:
            MagicalError: if the question or option does not exist, or the study is closed to the participant.
            OSError: if the answer cannot be saved.
        """
        with self._lock:
            asked = self.questions.get(question)
            if asked is None:
                raise SettingsError(f"this study does not ask {short_repr(question)}")
            verdict = asked.check(letter)
            if self.paused or (self.study.consent and participant not in self._consents):
                raise SettingsError("answers count only after consent, and while the study is not paused")
            if question not in self._answered[participant]:
                facts = {"set": asked.set, "kind": asked.kind, "intent": str(asked.intent), "answer": letter}
                facts |= {"right": verdict.right, "misread": verdict.misread, "seconds": _number(seconds)}
                self._note({"event": "answered", "participant": participant, "question": question, **facts})
            return self.answered(participant)

    def status(self) -> dict[str, Any]:
        """The study's progress, for its operator, as JSON data."""
        with self._lock:
            rows = []
            for (task, variant), wanted in self._quotas.items():
                pair, scores = (task, variant), list(self._accepted[task, variant].values())
                bins = Counter(min(int(score * BINS), BINS - 1) for score in scores)
                rows.append(
                    {"environment": f"{task}-{variant}", "wanted": wanted, "accepted": len(scores)}
                    | {"leased": len(self._leases(pair)), "refused": dict(self._refusals[pair])}
                    | {"histogram": [bins[index] for index in range(BINS)]}
                )
            people = len({*self._offers, *self._counts})
            about = {"title": self.study.title, "paused": self.paused, "saves": self._can_save()}
            return {**about, "participants": people, "environments": rows}

    def pause(self, paused: bool) -> None:
        """Pauses or resumes offers."""
        with self._lock:
            self._note({"event": "paused" if paused else "resumed"})

    def archive(self) -> bytes:
        """A zip file with all demonstrations and the log."""
        buffer = io.BytesIO()
        with self._lock, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in [*demos.files_in(self._folder), *self._folder.glob(LOG)]:
                archive.write(path, path.relative_to(self._folder))
        return buffer.getvalue()

    def _closed(self, participant: str, address: str) -> dict[str, Any] | None:
        """Data for the page with the reason why this participant gets no offer; None if offers are possible."""
        if self.study.episodes is not None and self._counts[participant] >= self.study.episodes:
            return {"why": "That was everything. Thank you!", "code": self.study.completion_code}
        if all(wanted is not None and len(self._accepted[pair]) >= wanted for pair, wanted in self._quotas.items()):
            code = self.study.completion_code if self._counts[participant] else ""
            return {"why": "That was everything: there are enough episodes. Thank you!", "code": code}
        if self.paused:
            return {"why": "The study is paused: please come back later"}
        moment = datetime.fromtimestamp(self._clock(), UTC)
        if self.study.opens is not None and moment < self.study.opens:
            return {"why": f"The study opens at {self.study.opens:%Y-%m-%d %H:%M %Z}"}
        if self.study.closes is not None and moment >= self.study.closes:
            return {"why": "The study is closed. Thank you for coming!"}
        if not self._can_save():
            return {"why": FULL}
        now, others = self._timer(), self._addresses.keys() & self._offers.keys() - {participant}
        here = [name for name in others if self._addresses[name] == address and self._offers[name].until > now]
        if address and len(here) >= self.study.per_address:
            return {"why": f"{len(here)} others play from your network address: please come back later"}
        return None

    def _open(self, pair: Pair, but: str) -> list[Offer]:
        """The valid offers of an environment to participants other than `but`."""
        now = self._timer()
        return [
            offer
            for participant, offer in self._offers.items()
            if offer[:2] == pair and offer.until > now and participant != but and offer.seed < PRACTICE
        ]

    def _leases(self, pair: Pair, but: str = "") -> list[int]:
        """The seeds of an environment that are reserved for participants other than `but`."""
        return [offer.seed for offer in self._open(pair, but) if offer.began]

    def _holds(self, participant: str, offer: Offer) -> bool:
        """Whether a participant may still play an offered scene: until others need it, even if the offer expired."""
        if offer.seed >= PRACTICE:
            return True
        pair: Pair = (offer.task, offer.variant)
        if pair not in self._quotas or offer.seed in self._accepted[pair]:
            return False
        wanted, others = self._quotas[pair], self._leases(pair, participant)
        in_use = len(self._accepted[pair]) + len(others)
        return offer.seed not in others and (wanted is None or in_use < wanted)

    def _choose(self, participant: str) -> Offer | None:
        """A free scene of the environment with the fewest episodes; None if all scenes are in use."""
        if self._practised[participant] < self.study.practice:
            task, variant = next(iter(self._quotas))
            return Offer(task, variant, PRACTICE + self._practised[participant], 0.0, began=False)
        used = {pair: len(self._accepted[pair]) + len(self._leases(pair, participant)) for pair in self._quotas}
        free = [pair for pair, wanted in self._quotas.items() if wanted is None or used[pair] < wanted]
        if not free:
            return None
        offered = {pair: {offer.seed for offer in self._open(pair, participant)} for pair in free}
        pair = min(free, key=lambda pair: len(self._accepted[pair]) + len(offered[pair]))
        taken = {*self._accepted[pair], *offered[pair]}
        return Offer(*pair, next(seed for seed in itertools.count() if seed not in taken), 0.0, began=False)

    def _offer(self, participant: str, offer: Offer) -> None:
        """Offers a scene from now on."""
        until = {"until": round(self._clock() + 60 * self.study.lease_minutes, 3)}
        self._note({"event": "offer", "participant": participant, **offer._asdict(), **until})

    def _count(self, participant: str, demo: Demonstration) -> None:
        """Counts a saved demonstration. A demonstration is counted only once."""
        pair: Pair = (demo.task, demo.variant)
        if demo.scene_seed not in self._accepted[pair]:
            self._counts[participant] += 1
        self._accepted[pair][demo.scene_seed] = demo.score
        self._episodes[_key(demo)] = participant, demo.score
        offer = self._offers.get(participant)
        if offer is not None and offer[:3] == (*pair, demo.scene_seed):
            del self._offers[participant]

    def _note(self, event: dict[str, Any]) -> None:
        """Writes an event to the log on the disk, and applies it."""
        line = json.dumps({"time": round(self._clock(), 3), **event}, separators=(",", ":"), allow_nan=False)
        with self._saving(), appending(self._folder / LOG) as log:
            log.append(f"{line}\n".encode(), durable=True)
        self._take(event)

    @contextmanager
    def _saving(self) -> Iterator[None]:
        """A context that saves something. After an error, the study is closed until something can be saved again."""
        self._saves = False
        yield
        self._saves = True

    def _can_save(self) -> bool:
        """Whether episodes can be saved, as far as is known. After an error, this is tried."""
        if not self._saves:
            with suppress(OSError), self._saving():
                files.write(self._folder / TRIAL, bytes(ROOM), overwrite=True)
                (self._folder / TRIAL).unlink()
        return self._saves

    def _take(self, event: Mapping[str, Any]) -> None:
        match event:
            case {"event": "consent", "participant": str(participant)}:
                self._consents.add(participant)
            case {"event": "offer", "participant": str(participant), "task": task, "variant": variant}:
                valid = min(
                    event["until"] - self._clock(), 60 * self.study.lease_minutes
                )  # the clock may have been set
                began = event.get("began", True)  # earlier versions reserved scenes at once
                self._offers[participant] = Offer(task, variant, event["seed"], self._timer() + valid, began)
            case {"event": "refused", "task": task, "variant": variant, "reason": reason}:
                self._refusals[task, variant][reason] += 1
            case {"event": "practised", "participant": str(participant)}:
                self._practised[participant] += 1
                self._offers.pop(participant, None)
            case {"event": "answered", "participant": str(participant), "question": str(question)}:
                self._answered[participant].add(question)
            case {"event": "paused" | "resumed"}:
                self.paused = event["event"] == "paused"

    def _read(self) -> None:
        """Applies all events in the log."""
        path = self._folder / LOG
        for number, line in read_lines(path, SettingsError) if path.exists() else ():
            try:
                self._take(json.loads(line))
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
                raise SettingsError(
                    f"line {number} of {path} is damaged: {short_repr(line)}. Delete it; if it contains "
                    'several events, each from {"time" on, delete only the incomplete one'
                ) from None


def _key(demo: Demonstration) -> str:
    """A key of an episode without its seed, since Demo's scenes do not depend on it."""
    return hashlib.sha256(demo.scene.to_json().encode() + demo.variant.encode() + demo.actions.tobytes()).hexdigest()


def _number(value: Any) -> float | None:
    """A finite number from a message; None for anything else."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and abs(value) <= sys.float_info.max else None
