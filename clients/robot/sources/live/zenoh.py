"""ROS 2 over Zenoh (`rmw_zenoh`) without local ROS.

A client only: no open port, no publishing, multicast only if requested.
"""

from __future__ import annotations

import importlib
import itertools
import json
import re
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import click

from clients.robot.sources.live.live_feed import MESSAGE_MAX_BYTES, Feed, Listener
from clients.robot.sources.live.zenoh_keys import (
    DOMAIN_MAX,
    HASHES_UNSAID,
    SequenceGaps,
    TopicKey,
    parse_key,
    parse_token,
    subscription_key,
)
from clients.robot.sources.messages.message_types import Message, types_with
from clients.robot.sources.messages.topics import load_topics
from consensus.errors import BlockRobotError

ENDPOINT_DEFAULT = "tcp/127.0.0.1:7447"
"""Where the router of `rmw_zenoh` listens on its own machine."""

OPEN_MAX_S = 5.0
TOKENS_MAX_S = 2.0
"""How long an answer about who publishes may take."""

LISTEN_FOR_S = 1.5
"""How long topics are listened for where nobody tells which there are."""

RECENT_S = 5.0
"""For so long after a message its topic is held to be there, where publishers do not announce themselves."""

TOPICS_MAX_COUNT = 4_096
HASH_SHOWN_CHARS = 19
"""Enough of a hash to tell two apart: `RIHS01_` and twelve digits."""

_ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws)/[^\s/?#]+:[0-9]{1,5}(#[^\s]*)?")
_TRIES = {"period_init_ms": 250, "period_max_ms": 4_000, "period_increase_factor": 2}


def _check_endpoints(_context: click.Context, _parameter: click.Parameter, texts: Sequence[str]) -> Sequence[str]:
    for text in texts:
        if not _ENDPOINT.fullmatch(text):
            raise click.BadParameter(f"{text!r} is no endpoint of Zenoh, such as {ENDPOINT_DEFAULT}.")
    return texts


OPTIONS = (
    click.option(
        "--zenoh-connect",
        multiple=True,
        metavar="tcp/HOST:PORT",
        callback=_check_endpoints,
        help=f"The Zenoh router or peer; of several, the first that answers. [default: {ENDPOINT_DEFAULT}]",
    ),
    click.option("--zenoh-scout", is_flag=True, help="Look for a Zenoh router by multicast instead."),
    click.option(
        "--ros-domain",
        type=click.IntRange(0, DOMAIN_MAX),
        envvar="ROS_DOMAIN_ID",
        default=0,
        help="The ROS 2 domain that is heard, by rclpy or over Zenoh. [default: ROS_DOMAIN_ID, or 0]",
    ),
)


def make_feeds(options: Mapping[str, Any]) -> Sequence[Feed]:
    """Raises TOPICS_INVALID."""
    definitions = load_topics(options.get("topics_file")).definitions
    scout = bool(options.get("zenoh_scout"))
    return [ZenohFeed(options.get("zenoh_connect") or (), options.get("ros_domain") or 0, definitions, scout=scout)]


class ZenohFeed:
    """One domain's ROS 2 topics, through the first answering endpoint, reconnecting.

    `definitions` supplies non-ROS types; messages with another type hash are refused.
    """

    name = "The Zenoh router"
    ros1 = False

    def __init__(
        self,
        endpoints: Sequence[str] = (),
        domain: int = 0,
        definitions: Mapping[str, str] | None = None,
        *,
        scout: bool = False,
    ) -> None:
        self._endpoints = list(endpoints) or ([] if scout else [ENDPOINT_DEFAULT])
        self._domain = domain
        self._scout = scout
        self._types = types_with(definitions or {})
        self._hashes: dict[str, str] = {}
        self._session: Any = None
        self._subscriptions: list[_Subscription] = []
        self._lock = threading.Lock()

    def topics(self) -> dict[str, str]:
        """Return topics by type: announced or heard; while open, wanted ones only."""
        session = self._session
        if session is not None:
            recent = [one.last_key for one in self._subscriptions if one.is_recent(time.monotonic())]
            return _by_topic([*recent, *self._announced(session)])
        with self._connect() as passing:
            return _by_topic(self._announced(passing) or self._heard(passing))

    def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
        """Subscribe to `wanted`. Raises FEED_UNREACHABLE, MIDDLEWARE_MISSING, TOPICS_INVALID for unknown or differing
        types.
        """
        keys = {topic: subscription_key(topic, self._domain) for topic in wanted}
        by_name = {"/" + topic.lstrip("/"): topic for topic in wanted}
        session = self._connect()
        try:
            for one in self._announced(session):
                if wanted.get(by_name.get(one.topic, "")):
                    self._check(one)
            library = _library()
            for topic, key in keys.items():
                heard = _Subscription(topic, self, listener)
                # In Zenoh's own thread: what this process is too slow for waits in no queue of Zenoh's, but is dropped
                # by the publisher, as a gap in its numbers tells.
                session.declare_subscriber(key, library.handlers.Callback(heard.take, indirect=False))
                self._subscriptions.append(heard)
        except BaseException:
            session.close()
            raise
        self._session = session

    def close(self) -> None:
        with self._lock:
            session, self._session = self._session, None
        if session is not None:
            session.close()

    def differs(self, key: TopicKey) -> bool:
        if key.hash in HASHES_UNSAID or not self._knows(key.type):
            return False
        if key.type not in self._hashes:
            self._hashes[key.type] = self._hash_of(key.type)
        return self._hashes[key.type] != key.hash

    def _hash_of(self, type_name: str) -> str:
        """Return the hash ROS 2 announces. Raises TOPICS_INVALID for undefined parts."""
        try:
            return self._types.hash_rihs01(type_name)
        except KeyError as error:
            detail = (
                f"The definition of {type_name} names a type that nobody defines: put that under [definitions], too."
            )
            raise BlockRobotError("TOPICS_INVALID", detail) from error

    def _knows(self, type_name: str) -> bool:
        return type_name in self._types.fielddefs

    def _check(self, one: TopicKey) -> None:
        if not self._knows(one.type):
            raise BlockRobotError(
                "TOPICS_INVALID",
                f"{one.topic} carries {one.type}, and Zenoh says no definitions: put its text under [definitions].",
            )
        if self.differs(one):
            known, found = self._hashes[one.type][:HASH_SHOWN_CHARS], one.hash[:HASH_SHOWN_CHARS]
            raise BlockRobotError(
                "TOPICS_INVALID",
                f"{one.topic} carries {one.type} of another definition ({found}...) than the robot knows ({known}...): "
                "put its text under [definitions].",
            )

    def _connect(self) -> Any:
        library = _library()
        settings: dict[str, Any] = {
            "mode": "client",
            "connect/endpoints": self._endpoints,
            "connect/timeout_ms": int(OPEN_MAX_S * 1000),
            "connect/retry": _TRIES,
            "scouting/timeout": int(OPEN_MAX_S * 1000),
            "scouting/multicast/enabled": self._scout,
            "scouting/gossip/enabled": False,
            "listen/endpoints": [],
            "adminspace/enabled": False,
            "transport/shared_memory/enabled": False,
            "transport/link/rx/max_message_size": MESSAGE_MAX_BYTES,
        }
        try:
            config = library.Config()
            for name, value in settings.items():
                config.insert_json5(name, json.dumps(value))
            return library.open(config)
        except library.ZError:
            where = ", ".join(self._endpoints) or "any address, by multicast"
            raise BlockRobotError("FEED_UNREACHABLE", f"No Zenoh router or peer answers at {where}.") from None

    def _announced(self, session: Any) -> set[TopicKey]:
        replies = session.liveliness().get(f"@ros2_lv/{self._domain}/**", timeout=TOKENS_MAX_S)
        return set(_limited(parse_token(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None))

    def _heard(self, session: Any) -> set[TopicKey]:
        found: dict[str, TopicKey | None] = {}

        def note(sample: Any) -> None:
            if len(found) < TOPICS_MAX_COUNT:
                found.setdefault(str(sample.key_expr), parse_key(str(sample.key_expr)))

        subscriber = session.declare_subscriber(f"{self._domain}/**", note)
        time.sleep(LISTEN_FOR_S)
        subscriber.undeclare()
        return set(_limited(iter(list(found.values()))))


class _Subscription:
    """Makes samples `Message`s in Zenoh's thread; never raises or waits."""

    def __init__(self, topic: str, feed: ZenohFeed, listener: Listener) -> None:
        self._topic = topic
        self._feed = feed
        self._listener = listener
        self._gaps = SequenceGaps()
        self._lock = threading.Lock()
        self._came_s = 0.0
        self.last_key: TopicKey | None = None

    def is_recent(self, now_s: float) -> bool:
        return self.last_key is not None and now_s - self._came_s < RECENT_S

    def take(self, sample: Any) -> None:
        at_ns = time.time_ns()
        try:
            key = parse_key(str(sample.key_expr))
            if key is None:
                return
            self.last_key, self._came_s = key, time.monotonic()
            if sample.attachment is not None:
                with self._lock:
                    missed = self._gaps.take(bytes(sample.attachment))
                if missed:
                    self._listener.miss(self._topic, missed)
            # Of another definition it is of another type: under a name that says so, the reader refuses it.
            type_name = f"{key.type} ({key.hash[:HASH_SHOWN_CHARS]})" if self._feed.differs(key) else key.type
            self._listener.deliver(Message(self._topic, type_name, at_ns, bytes(sample.payload)))
        except Exception:  # noqa: BLE001 - a stranger's sample must end neither the library's thread nor the run
            self._listener.deliver(Message(self._topic, "", at_ns, b""))  # of no type: it is refused and counted


def _library() -> Any:
    try:
        return importlib.import_module("zenoh")
    except ImportError:
        raise BlockRobotError(
            "MIDDLEWARE_MISSING",
            "Listening to Zenoh needs the package eclipse-zenoh: `make install-zenoh` in your clone.",
        ) from None


def _by_topic(found: Iterable[TopicKey | None]) -> dict[str, str]:
    known = sorted({(one.topic, one.type) for one in found if one is not None}, reverse=True)
    return dict(known)


def _limited(found: Iterator[TopicKey | None]) -> Iterator[TopicKey]:
    for one in itertools.islice(found, TOPICS_MAX_COUNT):
        if one is not None:
            yield one
