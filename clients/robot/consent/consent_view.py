"""Whom the robot may record now, by consents that the chain proves.

A picture is kept only under a fresh view, for a confirmed person whose consent to purpose and sensor holds and covers the
time taken. A refusal counts once seen, for everything not yet on chain. A sealed clip is recorded only by a view of a block
later than its last picture, or looked up `SETTLED_AFTER_MS` after it and confirmed by over two thirds of producers. Fresh:
header at most `STALE_AFTER_MS` (or two heartbeats) old, at most `CLOCK_AHEAD_MAX_MS` ahead.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Annotated, Protocol

import structlog

from clients.robot.consent.registry_reader import Majority, RegistryReader, RegistrySnapshot
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.pairing.rosters import RosterBook
from clients.sdk.terminal.json_answers import Answer, Count, Ms, doc
from consensus.errors import BlockRobotError
from consensus.state.consent import GIVEN, StepRow, effective_consent

REFRESH_EVERY_MS = 1_000
READ_WHOLE_EVERY_MS = 60_000
STALE_AFTER_MS = 120_000
CLOCK_AHEAD_MAX_MS = 10_000
SETTLED_AFTER_MS = 5_000
_PERSON_TAG = b"blockrobot/spooled-person"

_NO_ROBOT = frozenset({"SESSION_REFUSED", "SENDER_NOT_ADMITTED"})
"""The node does not take the robot for a member: if the others do not either, it was revoked and will not read again."""

_Place = tuple[bytes, str, str, int]
"""Whose consent, to which purpose and sensor, from which height on."""

_log = structlog.get_logger("consents")


class ConsentCounts(Answer, frozen=True, kw_only=True):
    """What was read of consents."""

    readings: Annotated[Count, doc("How often the registry was proved")]
    failed_readings: Annotated[Count, doc("How often it could not be")]
    stale_times: Annotated[Count, doc("How often what was proved was too old to record by")]
    stale_ms: Annotated[Ms, doc("For how long, together")]
    sightings_refused: Annotated[
        dict[str, Count],
        doc("Tag readings that counted for nothing, by reason: `no-consent`, `consent-coming`, `registry-stale`"),
    ]
    clips_dropped: Annotated[Count, doc("Clips dropped from the spool: consent had ended, or they were too old")]


def compute_stale_after_ms(heartbeat_ms: int) -> int:
    """Return the maximum header age, for idle chains' heartbeat blocks."""
    return max(STALE_AFTER_MS, 2 * heartbeat_ms)


def compute_person_tag(spool_key: bytes, handle: bytes) -> bytes:
    """Return 32 bytes: HMAC under the spool's key."""
    return hmac.new(spool_key, _PERSON_TAG + handle, hashlib.sha256).digest()


@dataclass(slots=True)
class ConsentFigures:
    """Consent figures of a run's summary; times in ms."""

    readings: int = 0
    failures: int = 0
    stale_count: int = 0
    stale_ms: int = 0
    sightings_refused: dict[str, int] = field(default_factory=dict)
    clips_dropped: int = 0

    def summarise(self, stale_now_ms: int = 0) -> ConsentCounts:
        """`stale_now_ms`: for how long the view has been stale now."""
        return ConsentCounts(
            readings=self.readings,
            failed_readings=self.failures,
            stale_times=self.stale_count,
            stale_ms=self.stale_ms + stale_now_ms,
            sightings_refused=dict(sorted(self.sightings_refused.items())),
            clips_dropped=self.clips_dropped,
        )


class SealedClip(Protocol):
    """Whom and what a sealed clip shows; times in ms."""

    @property
    def person(self) -> bytes: ...

    @property
    def purpose(self) -> str: ...

    @property
    def sensor(self) -> str: ...

    @property
    def captured_from_ms(self) -> int: ...

    @property
    def captured_until_ms(self) -> int: ...

    @property
    def decided_at_ms(self) -> int: ...


class Consents:
    """Registry view; `on_change` is called after each reading, `tell` when it grows stale or is fresh again."""

    def __init__(
        self,
        reader: RegistryReader,
        roster: RosterBook,
        *,
        majority: Majority,
        person_key: bytes,
        stale_after_ms: Callable[[], int],
        now_ms: Callable[[], int],
        tell: Callable[[str], None] = lambda _sentence: None,
    ) -> None:
        self._tell = tell
        self._reader = reader
        self._majority = majority
        self._persons = {compute_person_tag(person_key, row.handle): row.handle for row in roster.rows}
        self._person_key = person_key
        self._stale_after_ms = stale_after_ms
        self._now_ms = now_ms
        self._view: RegistrySnapshot | None = None
        self._settled_at_ms = 0
        self._waited_for: list[int] = []
        self._read_whole_at_ms = 0
        self._coming: set[_Place] = set()
        self._begun_ms: dict[_Place, int] = {}
        self._news = asyncio.Event()
        self._stale_since_ms: int | None = None
        self._failure: BlockRobotError | None = None
        self.figures = ConsentFigures()
        self.on_change: Callable[[], None] = lambda: None

    def __len__(self) -> int:
        return len(self._view.people) if self._view is not None else 0

    # The view

    async def refresh(self) -> None:
        """Read the registry again; on errors, raise and keep the view."""
        looked_at_ms = self._now_ms()
        known = self._view
        if looked_at_ms - self._read_whole_at_ms >= READ_WHOLE_EVERY_MS:
            known = None
        settled = self._is_quorum_wanted(looked_at_ms) and await self._hear_quorum()
        found = await self._reader.read(known)
        if looked_at_ms - found.timestamp_ms > self._stale_after_ms() // 2:
            # This node may be cut off from the others and not know it.
            await self._reader.catch_up()
            found = await self._reader.read(known)
        if known is None or found.people is not known.people:
            self._read_whole_at_ms = looked_at_ms
        self._view, self._failure = found, None
        if settled:
            self._settled_at_ms = looked_at_ms
        self.figures.readings += 1
        self._note_beginnings(found)
        self.on_change()

    def _is_quorum_wanted(self, now_ms: int) -> bool:
        settled_ms = now_ms - SETTLED_AFTER_MS
        return any(at_ms <= settled_ms and not self._knows_of(at_ms) for at_ms in self._waited_for)

    async def _hear_quorum(self) -> bool:
        try:
            return await self._majority.confirm_with_quorum()
        except BlockRobotError as error:
            _log.warning("quorum_unreachable", code=error.code)
            return False

    def _note_beginnings(self, view: RegistrySnapshot) -> None:
        """A consent seen before its height begins at the first block from there; unbroken prolongation keeps its start."""
        places = dict(_places(view))
        self._begun_ms = {place: began for place, began in self._begun_ms.items() if place in places}
        self._coming &= places.keys()
        for place, prolonged in places.items():
            if place[3] > view.height:
                self._coming.add(place)
            elif prolonged is not None:
                self._coming.discard(place)
                if prolonged in self._begun_ms:
                    self._begun_ms.setdefault(place, self._begun_ms[prolonged])
            elif place in self._coming:
                self._coming.discard(place)
                self._begun_ms[place] = view.timestamp_ms

    async def watch(self) -> None:
        """Read until cancelled; an unreachable registry makes the view stale."""
        while True:
            await asyncio.sleep(REFRESH_EVERY_MS / 1000)
            try:
                await self._read_again()
            except Exception:
                # Whatever waits for a newer view must hear that there will be none.
                self._failure, self._view = BlockRobotError("INTERNAL", "The registry cannot be read."), None
                self.note_freshness()
                raise
            self.note_freshness()

    async def _read_again(self) -> None:
        try:
            await self.refresh()
        except BlockRobotError as error:
            self.figures.failures += 1
            _log.warning("registry_read_failed", code=error.code)
            is_over = error.code == "ROSTER_INVALID"
            if is_over or (error.code in _NO_ROBOT and await self._majority.is_rejected_by_network()):
                self._failure, self._view = error, None

    def raise_failure(self) -> None:
        """Raise why reading ended for good: SESSION_REFUSED, ROSTER_INVALID, INTERNAL."""
        if self._failure is not None:
            raise self._failure

    async def wait_fresh(self, timeout_ms: int) -> None:
        """Wait for a recent block; needs `watch`. Raises REGISTRY_STALE."""
        try:
            async with asyncio.timeout(timeout_ms / 1000):
                while not self.is_fresh():
                    self.raise_failure()
                    await self._news.wait()
        except TimeoutError:
            raise BlockRobotError("REGISTRY_STALE") from None

    def note_freshness(self) -> None:
        now_ms = self._now_ms()
        if self.is_fresh():
            if self._stale_since_ms is not None:
                lasted_ms = now_ms - self._stale_since_ms
                self.figures.stale_ms += lasted_ms
                self._stale_since_ms = None
                self._say(f"The network makes blocks again, after {lasted_ms / 1000:.0f} s: the robot goes on.")
        elif self._stale_since_ms is None:
            self._stale_since_ms = now_ms
            self.figures.stale_count += 1
            self._say(
                "The network does not answer, or nothing becomes final: the robot waits, and keeps nothing meanwhile. "
                "`blockrobot doctor` says more."
            )
        news, self._news = self._news, asyncio.Event()
        news.set()

    def _say(self, sentence: str) -> None:
        with suppress(OSError, ValueError):  # a terminal that is gone ends no watch
            self._tell(sentence)

    def is_fresh(self) -> bool:
        if self._view is None:
            return False
        return -CLOCK_AHEAD_MAX_MS <= self._now_ms() - self._view.timestamp_ms <= self._stale_after_ms()

    def summarise(self) -> ConsentCounts:
        self.note_freshness()
        since_ms = self._stale_since_ms
        return self.figures.summarise(0 if since_ms is None else self._now_ms() - since_ms)

    # Answers

    def check_may_keep(self, handle: bytes, purpose: str, sensor: str, taken_at_ms: int) -> WithholdReason | None:
        """Return why a picture taken then may not be kept, or None."""
        if self._view is None or not self.is_fresh():
            return WithholdReason.STALE
        consent = self._consent(self._view, handle, purpose, sensor)
        if consent is None:
            return WithholdReason.NO_CONSENT
        began_ms = self._began_ms(handle, purpose, sensor, consent)
        ended = consent.until_ms and taken_at_ms >= consent.until_ms
        return WithholdReason.OUTSIDE if taken_at_ms < began_ms or ended else None

    def is_coming(self, handle: bytes, purpose: str, sensor: str) -> bool:
        """Return whether a consent awaits its height."""
        return any(place[:3] == (handle, purpose, sensor) for place in self._coming)

    def find_beginning(self, handle: bytes, purpose: str, sensor: str) -> int | None:
        """Return when the present unbroken consent began."""
        consent = None if self._view is None else self._consent(self._view, handle, purpose, sensor)
        return None if consent is None else self._began_ms(handle, purpose, sensor, consent)

    def _began_ms(self, handle: bytes, purpose: str, sensor: str, consent: StepRow) -> int:
        begun_ms = self._begun_ms.get((handle, purpose, sensor, consent.height), 0)
        return max(consent.since_ms, consent.from_ms, begun_ms)

    @staticmethod
    def _consent(view: RegistrySnapshot, handle: bytes, purpose: str, sensor: str) -> StepRow | None:
        choices = view.people.get(handle)
        return None if choices is None else effective_consent(choices.get((purpose, sensor), ()), view.height)

    def person_tag(self, handle: bytes) -> bytes:
        return compute_person_tag(self._person_key, handle)

    async def may_record_clip(self, clip: SealedClip) -> bool:
        """Wait for a fresh view later than the clip's last picture; return whether it may be recorded. In replays faster
        than real time, the sealing time counts. Raises SESSION_REFUSED, INTERNAL.
        """
        handle = self._persons.get(clip.person)
        ends = (clip.captured_from_ms, clip.captured_until_ms)
        while True:
            await self._wait_to_know_of(min(clip.captured_until_ms, clip.decided_at_ms))
            if handle is None:
                return False
            refusals = {self.check_may_keep(handle, clip.purpose, clip.sensor, at_ms) for at_ms in ends}
            if WithholdReason.STALE not in refusals:
                return refusals == {None}
            # The view turned stale since: that is no word of theirs.
            await self._news.wait()

    async def _wait_to_know_of(self, at_ms: int) -> None:
        self._waited_for.append(at_ms)
        try:
            while not self._knows_of(at_ms):
                self.raise_failure()
                await self._news.wait()
        finally:
            self._waited_for.remove(at_ms)

    def _knows_of(self, at_ms: int) -> bool:
        """Whether the view is fresh and includes every refusal until then."""
        if self._view is None or not self.is_fresh():
            return False
        return self._view.timestamp_ms >= at_ms or self._settled_at_ms >= at_ms + SETTLED_AFTER_MS


def _places(view: RegistrySnapshot) -> Iterator[tuple[_Place, _Place | None]]:
    for handle, choices in view.people.items():
        for (purpose, sensor), steps in choices.items():
            for before, step in zip((None, *steps), steps, strict=False):
                if step.status == GIVEN:
                    prolongs = before is not None and _is_prolonged(before, step, view.timestamp_ms)
                    earlier = (handle, purpose, sensor, before.height) if before is not None and prolongs else None
                    yield (handle, purpose, sensor, step.height), earlier


def _is_prolonged(before: StepRow, step: StepRow, now_ms: int) -> bool:
    same = before.status == GIVEN and step.since_ms == max(before.since_ms, before.from_ms)
    return same and (before.until_ms == 0 or now_ms < before.until_ms)
