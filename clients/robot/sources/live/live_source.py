"""Live feeds as one real-time source with a bounded, dropping queue."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import NamedTuple, Self

from clients.robot.sensing.sensor_events import Depth, RefusedMessage, Sighting, SourceEvent
from clients.robot.sources.live.live_feed import Feed
from clients.robot.sources.live.live_queue import LiveQueue, Queued
from clients.robot.sources.messages.decoding import (
    IMAGE_TYPES,
    KINDS,
    AntennaCounts,
    MessageReader,
    info_topic,
    read_focal_px,
    wrong_type,
)
from clients.robot.sources.messages.message_types import LearntTypes, Message, MessageTypes, types_with
from clients.robot.sources.messages.topics import Topics, missing_field
from clients.robot.sources.recordings.topic_listing import LISTED_MAX_COUNT
from clients.robot.sources.source import Clock, SystemClock
from consensus.errors import BlockRobotError

SILENT_AFTER_S = 5.0


class Watch:
    """Watches a feed's `wanted` topics, and silence of `camera`."""

    def __init__(self, name: str, wanted: Collection[str], camera: str) -> None:
        self.gone: Counter[str] = Counter()
        self._name = name
        self._wanted = sorted(wanted)
        self._camera = camera
        self._there: dict[str, bool] = {}
        self._reachable = True
        self._silent_since_s: float | None = None

    def look(self, advertised: Mapping[str, str] | None) -> list[str]:
        """Return changes; `advertised` None: the feed does not answer."""
        if advertised is None:
            sentences = [f"{self._name} does not answer; what is connected goes on."] if self._reachable else []
            self._reachable = False
            return sentences
        sentences = [] if self._reachable else [f"{self._name} answers again."]
        self._reachable = True
        for topic in self._wanted:
            is_there = topic in advertised
            if is_there and self._there.get(topic) is False:
                sentences.append(f"{topic} is there.")
            elif not is_there and self._there.get(topic, True):
                self.gone[topic] += topic in self._there
                sentences.append(f"{topic} is not advertised; it is waited for.")
            self._there[topic] = is_there
        return sentences

    def listen(self, now_s: float, heard_s: float) -> list[str]:
        """Return changes, by present and last-heard seconds of one clock."""
        if now_s - heard_s >= SILENT_AFTER_S:
            is_new = self._silent_since_s is None
            self._silent_since_s = heard_s if is_new else self._silent_since_s
            return [f"{self._camera} is silent: no frame for {SILENT_AFTER_S:g} s."] if is_new else []
        if self._silent_since_s is None:
            return []
        lasted_s, self._silent_since_s = heard_s - self._silent_since_s, None
        return [f"{self._camera} is heard again, after {max(lasted_s, SILENT_AFTER_S):.0f} s."]


INFO_TYPE = "sensor_msgs/msg/CameraInfo"
INFO_WAIT_S = 2.0
LOOK_EVERY_S = 2.0
SENTENCES_MAX_COUNT = 256
YIELD_EVERY_COUNT = 16
_FOREVER_MS = 1 << 53

OnProgress = Callable[[str], None]


class LiveCounts(NamedTuple):
    """Messages by kind (`missed`: dropped; `unread`) and by topic, and how often a topic was gone."""

    missed: dict[str, int]
    unread: dict[str, int]
    heard: dict[str, int]
    never_came: dict[str, int]
    gone: dict[str, int]


class LiveSource:
    """A source of `feeds`, as context; `on_progress` receives status sentences in `play`'s thread.

    Entering raises FEED_UNREACHABLE, MIDDLEWARE_MISSING, TOPICS_INVALID. Before `play` only focal length counts.
    """

    def __init__(self, feeds: Sequence[Feed], topics: Topics, on_progress: OnProgress | None = None) -> None:
        self._feeds = tuple(feeds)
        self._topics = topics
        self._kinds = {topic: KINDS[what] for topic, what in topics.wanted.items()}
        self._known = types_with(topics.definitions)
        self._on_progress = on_progress or (lambda _: None)
        self._reader = MessageReader(topics)
        self._queue = LiveQueue()
        self._opened = ExitStack()
        self._began_ms: int | None = None
        self._is_playing = False
        self._failure: BlockRobotError | None = None
        self._wake: Callable[[], None] = lambda: None
        self._sentences: deque[str] = deque(maxlen=SENTENCES_MAX_COUNT)
        self._wake_teller: Callable[[], None] = lambda: None
        self._heard: Counter[str] = Counter()
        self._missing: Counter[str] = Counter()
        self._gone: Counter[str] = Counter()
        self._counting = threading.Lock()
        self._frame_came_s = 0.0
        self._unread: Counter[str] = Counter()
        self._focal_px = topics.focal_px
        self._focal_known = threading.Event()
        # Readers with a connection of their own have no topics.
        self._watches = {feed: Watch(feed.name, topics.wanted, topics.depth) for feed in self._feeds[:1]}

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            info = info_topic(self._topics)
            is_told = False
            for feed in self._feeds:
                advertised = feed.topics()
                for topic in self._kinds.keys() & advertised.keys():
                    self._check(topic, advertised[topic], ros1=feed.ros1)
                wanted = {topic: advertised.get(topic, "") for topic in self._kinds}
                if self._focal_px is None:
                    wanted[info] = INFO_TYPE
                opening.callback(feed.close)
                feed.open(wanted, _FeedListener(self, LearntTypes(self._known, ros1=feed.ros1)))
                is_told = is_told or info in advertised
            if is_told and self._focal_px is None:
                self._focal_known.wait(INFO_WAIT_S)
            self._opened = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_playing = False
        self._opened.close()

    @property
    def topics(self) -> Topics:
        return self._topics

    @property
    def start_ms(self) -> int:
        """When playing began; until then, the present."""
        return SystemClock().now_ms() if self._began_ms is None else self._began_ms

    @property
    def focal_px(self) -> float | None:
        return self._focal_px

    @property
    def focal_from(self) -> str:
        return "camera-info" if self._topics.focal_px is None else "topics"

    @property
    def camera_topic(self) -> str:
        return self._topics.depth

    def describe_images(self) -> str:
        advertised = _advertised(self._feeds[0]) or {}
        images = sorted(topic for topic, kind in advertised.items() if kind in IMAGE_TYPES)
        more = f" and {len(images) - LISTED_MAX_COUNT} more" if len(images) > LISTED_MAX_COUNT else ""
        shown = ", ".join(images[:LISTED_MAX_COUNT])
        return f"Images are on {shown}{more}." if images else "No topic of images is there."

    @property
    def antennas_unnamed(self) -> AntennaCounts:
        """Readings by antennas unnamed in the topics file."""
        return self._reader.antennas_unnamed

    def shift_to(self, start_ms: int) -> None:
        """Ignored: what is live cannot be moved."""

    def empty_frames(self) -> list[Depth]:
        """Raises EMPTY_SCENE_MISSING: live frames may show somebody."""
        raise BlockRobotError(
            "EMPTY_SCENE_MISSING",
            "A live camera has no frames of the empty scene by itself. Record some with `blockrobot robot background "
            "record --source ... --viewpoint NAME`, have them approved, and run with --viewpoint NAME.",
        )

    def events(self) -> Iterator[SourceEvent]:
        """Raises USAGE_INVALID: live sources need `play`."""
        raise BlockRobotError("USAGE_INVALID", "A live source can only be played in real time.")

    async def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        """Yield events until `clock` wakes sleepers; then raise feed errors."""
        loop = asyncio.get_running_loop()
        came = asyncio.Event()
        self._wake = lambda: _call_in(loop, came.set)
        self._wake_teller = lambda: _call_in(loop, self._tell_all)
        ending = asyncio.create_task((clock or SystemClock()).sleep_until(_FOREVER_MS))
        ending.add_done_callback(lambda _: came.set())
        watching = asyncio.create_task(self._watch())
        self._began_ms, self._frame_came_s = SystemClock().now_ms(), time.monotonic()
        self._is_playing, taken_count = True, 0
        self._tell_all()
        try:
            while not ending.done():
                came.clear()
                entry = self._queue.take(self._wake)
                if entry is None:
                    if self._failure is not None:
                        raise self._failure
                    await came.wait()
                    continue
                for event in self._read(entry):
                    yield event
                taken_count += 1
                if taken_count % YIELD_EVERY_COUNT == 0:  # a storm must not keep deliveries and consents waiting
                    await asyncio.sleep(0)
        finally:
            self._is_playing = False
            self._unread = self._queue.clear()
            ending.cancel()
            watching.cancel()
            self._tell_all()

    def count_intake(self) -> LiveCounts:
        gone = self._gone.copy()
        for watch in self._watches.values():
            gone += watch.gone
        return LiveCounts(
            missed=dict(sorted(self._queue.missed.items())),
            unread=dict(sorted(self._unread.items())),
            heard=dict(sorted(self._heard.items())),
            never_came=dict(sorted(self._missing.items())),
            gone=dict(sorted(gone.items())),
        )

    def hear(self, message: Message, types: MessageTypes) -> None:
        if message.topic not in self._kinds:
            self._look_through(message, types)
        elif self._is_playing:
            kind = self._kinds[message.topic]
            with self._counting:
                self._heard[message.topic] += 1
            if kind == "frame":
                self._frame_came_s = time.monotonic()
            self._queue.put(Queued(kind, (message, types)))

    def hear_ready(self, kind: str, event: Sighting | RefusedMessage) -> None:
        if self._is_playing:
            self._queue.put(Queued(kind, event))

    def note_missing(self, topic: str, count: int) -> None:
        if self._is_playing and topic in self._kinds:
            with self._counting:
                self._missing[topic] += count

    def note_presence(self, part: str, *, here: bool) -> None:
        with self._counting:
            self._gone[part] += not here
        self._say(f"{part} is there." if here else f"{part} is gone; it is waited for.")

    def note_unusable(self, topic: str, error: BlockRobotError, *, for_good: bool) -> None:
        """Report and count an unhearable topic; without camera the run ends."""
        if topic == self._topics.depth and for_good:
            self.lose(error)
            return
        self._say(f"{error.detail} The run goes on without {topic}.")
        if topic in self._kinds:
            kind = self._kinds[topic]
            self._queue.put(Queued(kind, RefusedMessage(SystemClock().now_ms(), kind, "type")))

    def lose(self, error: BlockRobotError) -> None:
        self._failure = self._failure or BlockRobotError("FEED_LOST", error.detail)
        self._wake()

    def _check(self, topic: str, type_name: str, *, ros1: bool) -> None:
        wrong = wrong_type(self._topics, topic, type_name)
        if wrong:
            raise BlockRobotError("TOPICS_INVALID", wrong)
        own = MessageTypes(self._known, ros1=False)
        # In ROS 1 each publisher defines its types, with its messages only: what fits none is refused then, and counted.
        misspelt = missing_field(self._topics, topic, type_name, own) if own.knows(type_name) and not ros1 else ""
        if misspelt:
            raise BlockRobotError("TOPICS_INVALID", misspelt)

    def _read(self, entry: Queued) -> Sequence[SourceEvent]:
        return self._reader.read(*entry.what) if isinstance(entry.what, tuple) else [entry.what]

    def _look_through(self, message: Message, types: MessageTypes) -> None:
        if self._focal_px is None and message.type == INFO_TYPE:
            with suppress(BlockRobotError):
                self._focal_px = read_focal_px(types.decode(message))
            self._focal_known.set()

    async def _watch(self) -> None:
        while True:
            for feed, watch in self._watches.items():
                for sentence in watch.look(await asyncio.to_thread(_advertised, feed)):
                    self._say(sentence)
            for sentence in next(iter(self._watches.values())).listen(time.monotonic(), self._frame_came_s):
                self._say(sentence)
            await asyncio.sleep(LOOK_EVERY_S)

    def _say(self, sentence: str) -> None:
        self._sentences.append(sentence)
        self._wake_teller()

    def _tell_all(self) -> None:
        while self._sentences:
            with suppress(OSError, ValueError):
                self._on_progress(self._sentences.popleft())


class _FeedListener:
    def __init__(self, source: LiveSource, types: LearntTypes) -> None:
        self._source = source
        self._types = types

    def learn(self, type_name: str, definition: str) -> None:
        self._types.learn(type_name, definition)

    def deliver(self, message: Message, definition: str = "") -> None:
        self._source.hear(message, self._types.of(message.type, definition))

    def sight(self, sighting: Sighting) -> None:
        self._source.hear_ready("sighting", sighting)

    def refuse(self, refused: RefusedMessage) -> None:
        self._source.hear_ready(refused.kind, refused)

    def miss(self, topic: str, count: int) -> None:
        self._source.note_missing(topic, count)

    def presence(self, part: str, *, here: bool) -> None:
        self._source.note_presence(part, here=here)

    def unusable(self, topic: str, error: BlockRobotError, *, for_good: bool) -> None:
        self._source.note_unusable(topic, error, for_good=for_good)

    def fail(self, error: BlockRobotError) -> None:
        self._source.lose(error)


def _advertised(feed: Feed) -> Mapping[str, str] | None:
    try:
        return feed.topics()
    except Exception:  # noqa: BLE001 - a library fails in ways of its own, and the watch must go on
        return None


def _call_in(loop: asyncio.AbstractEventLoop, what: Callable[[], None]) -> None:
    with suppress(RuntimeError):  # the loop is closed: nobody waits any more
        loop.call_soon_threadsafe(what)
