"""ROS 2 live feed by the user's rclpy, raw CDR subscriptions.

rclpy is kept from signals, logs and command line, and used by one thread at a time. Nothing is published or decoded.
"""

from __future__ import annotations

import importlib
import logging
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from clients.robot.sources.live import ros2_types
from clients.robot.sources.live.live_feed import CLOSE_MAX_S, NODE_NAME, Feed, Listener
from clients.robot.sources.messages.decoding import IMAGE_TYPES
from clients.robot.sources.messages.message_types import Message
from consensus.errors import BlockRobotError

OWN_TOPIC = "/parameter_events"
"""What every node publishes, ours too, and nobody wants of it."""


SETTLED_S = 1.0
"""For how long nothing new is to be heard of."""


LOOK_MIN_S, LOOK_MAX_S = 4.0, 8.0
"""Who is lost in the first packets is heard of with the next announcement, which Fast DDS makes every three seconds
(`leaseDuration_announcementperiod`). Of an empty graph only time tells that it is empty."""


class Discovery:
    """Discovery since `started_s`, in monotonic seconds."""

    def __init__(self, started_s: float) -> None:
        self.found: dict[str, str] = {}
        self._started_s = self._changed_s = started_s

    def is_known(self, advertised: Mapping[str, str], now_s: float) -> bool:
        """Return whether the advertised topics (by type) are complete."""
        if advertised != self.found:
            self.found, self._changed_s = dict(advertised), now_s
        looked_s = now_s - self._started_s
        if looked_s < LOOK_MIN_S or not self.found.keys() - {OWN_TOPIC}:
            return looked_s >= LOOK_MAX_S
        return now_s - self._changed_s >= SETTLED_S or looked_s >= LOOK_MAX_S


LOOK_EVERY_S = 0.5
"""How often the graph is looked at: so late may a topic be subscribed that appears, or whose publisher has changed."""

SPIN_MAX_S = 0.1
DISCOVERY_POLL_S = 0.05
SUBSCRIBE_MAX_S = 1.0
DETAIL_MAX_CHARS = 200
IMAGE_QUEUE_MAX_COUNT = 16
"""Half a second of a camera. The robot's own queue drops and counts what is too much; this one would not say."""

QUEUE_MAX_COUNT = 1024

OPTIONS: tuple[Callable[[Any], Any], ...] = ()

_log = logging.getLogger(__name__)


def make_feeds(options: Mapping[str, Any]) -> Sequence[Feed]:
    return [Ros2Feed(options.get("ros_domain"))]


class Ros2Feed:
    """The environment's ROS 2 graph; `domain` overrides ROS_DOMAIN_ID."""

    name = "The ROS 2 graph"
    ros1 = False

    def __init__(self, domain: int | None = None) -> None:
        self._domain = domain
        self._wanted: dict[str, str] = {}
        self._heard: dict[str, _Heard] = {}
        self._unusable: dict[str, str] = {}
        self._advertised: dict[str, str] = {}
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def topics(self) -> dict[str, str]:
        """Return published topics, in `LOOK_MIN_S` to `LOOK_MAX_S` before `open`. Raises FEED_UNREACHABLE,
        MIDDLEWARE_MISSING.
        """
        if self._thread is not None:
            return dict(self._advertised)
        joined = _Joined.join(_Bindings(), self._domain)
        try:
            return joined.discover()
        finally:
            joined.leave()

    def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
        """Join and listen in a thread, subscribing topics as advertised.

        Waits `SUBSCRIBE_MAX_S` for typed topics. Raises FEED_UNREACHABLE, and MIDDLEWARE_MISSING for missing or
        differing types; other topics are reported unusable.
        """
        bindings = _Bindings()
        told = {topic for topic, type_name in wanted.items() if type_name}
        for topic in sorted(told):
            bindings.find(topic, wanted[topic])
        self._wanted = dict(wanted)
        joined = _Joined.join(bindings, self._domain)
        try:
            deadline_s = time.monotonic() + SUBSCRIBE_MAX_S
            while True:
                for topic, error in self._look(joined, listener):
                    if topic in told:
                        raise error
                    _tell_unusable(listener, topic, error)
                if not told - self._heard.keys() or time.monotonic() > deadline_s:
                    break
                time.sleep(DISCOVERY_POLL_S)
        except BaseException:
            joined.leave()
            raise
        self._thread = threading.Thread(target=self._run, args=(joined, listener), name="ros2-feed", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join(CLOSE_MAX_S)

    def _run(self, joined: _Joined, listener: Listener) -> None:
        look_at_s = time.monotonic() + LOOK_EVERY_S
        try:
            while not self._closing.is_set():
                if time.monotonic() >= look_at_s:
                    for topic, error in self._look(joined, listener):
                        _tell_unusable(listener, topic, error)
                    look_at_s = time.monotonic() + LOOK_EVERY_S
                joined.spin(SPIN_MAX_S)
        except Exception as error:  # noqa: BLE001 - rclpy fails in many ways, and nobody else watches its thread
            told = f"rclpy failed: {type(error).__name__}: {_cut(error)}."
            listener.fail(BlockRobotError("FEED_LOST", told))
        finally:
            joined.leave()

    def _look(self, joined: _Joined, listener: Listener) -> list[tuple[str, BlockRobotError]]:
        """Subscribe, again where type or reliability changed; return newly unusable topics."""
        advertised, unusable = joined.advertised(), []
        for topic, told in self._wanted.items():
            publishers = joined.publishers(topic) if topic in advertised else []
            if not publishers:
                continue
            heard = self._heard.get(topic)
            advertised[topic] = _choose_type({one.type for one in publishers}, heard.type if heard else "", told)
            try:
                self._subscribe(joined, listener, topic, [one for one in publishers if one.type == advertised[topic]])
                if self._unusable.pop(topic, None) is not None:
                    listener.presence(topic, here=True)
            except BlockRobotError as error:
                if self._unusable.get(topic) != error.detail:
                    unusable.append((topic, error))
                self._unusable[topic] = error.detail
        self._advertised = advertised
        return unusable

    def _subscribe(self, joined: _Joined, listener: Listener, topic: str, publishers: list[_Publisher]) -> None:
        """Raises MIDDLEWARE_MISSING."""
        heard = self._heard.get(topic)
        wish = _Heard(publishers[0].type, all(one.is_reliable for one in publishers))
        found = joined.bindings.find(topic, wish.type)
        is_other = found.is_other({one.type_hash for one in publishers if one.type_hash})
        if heard is not None and (is_other or heard != wish):
            joined.unsubscribe(self._heard.pop(topic).subscription)
        if is_other:
            package = wish.type.partition("/")[0]
            detail = (
                f"The publisher of {topic} was built with another version of {wish.type} than the one that Python finds. "
                f"Build {package} anew for both, source it, and start again."
            )
            raise BlockRobotError("MIDDLEWARE_MISSING", detail, until="the publisher ends")
        if topic not in self._heard:
            listener.learn(wish.type, found.definition)
            wish.subscription = joined.subscribe(topic, wish, listener)
            self._heard[topic] = wish


@dataclass(slots=True)
class _Heard:
    """A topic's subscription; equal if the request is the same."""

    type: str
    is_reliable: bool
    subscription: Any = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class _Publisher:
    """A publisher's offer; `type_hash` by REP 2011, empty before ROS 2 Iron."""

    type: str
    is_reliable: bool
    type_hash: str


def _choose_type(offered: set[str], heard: str, told: str) -> str:
    """Present, else requested, else any."""
    return next((name for name in (heard, told) if name in offered), min(offered))


def _tell_unusable(listener: Listener, topic: str, error: BlockRobotError) -> None:
    listener.unusable(topic, error, for_good="until" not in error.context)


def _cut(error: Exception) -> str:
    return str(error)[:DETAIL_MAX_CHARS]


class _Bindings:
    """rclpy and Python message types. Raises MIDDLEWARE_MISSING."""

    def __init__(self) -> None:
        loggers = logging.getLoggerClass()
        try:
            self.rclpy = importlib.import_module("rclpy")
            importlib.import_module("rclpy.impl.implementation_singleton")
            for name in ("context", "event_handler", "executors", "node", "parameter", "qos"):
                importlib.import_module(f"rclpy.{name}")
        except Exception as error:  # a library of another system, or of another Python, fails in many ways
            version = f"{sys.version_info.major}.{sys.version_info.minor}"
            detail = (
                f"Python {version} cannot import rclpy ({_cut(error)}). In the terminal in which you start BlockRobot, "
                "first type `source /opt/ros/DISTRO/setup.bash`, for DISTRO jazzy, kilted or yours; BlockRobot must be "
                "installed with the Python of that ROS 2 (jazzy, kilted: 3.12)."
            )
            raise BlockRobotError("MIDDLEWARE_MISSING", detail) from error
        finally:
            logging.setLoggerClass(loggers)
        self._types: dict[str, ros2_types.RosType] = {}

    def find(self, topic: str, type_name: str) -> ros2_types.RosType:
        """Raises MIDDLEWARE_MISSING."""
        if type_name not in self._types:
            try:
                self._types[type_name] = ros2_types.load(type_name)
            except ros2_types.NotFoundError as error:
                package = type_name.partition("/")[0]
                detail = (
                    f"Topic {topic} carries {type_name}, and {error}. In the terminal in which you start BlockRobot, "
                    f"first source the workspace that has {package}: `source WORKSPACE/install/setup.bash`."
                )
                raise BlockRobotError("MIDDLEWARE_MISSING", detail) from error
        return self._types[type_name]


class _Joined:
    """Our own node, context and executor; messages arrive only in `spin`."""

    def __init__(self, bindings: _Bindings, context: Any, node: Any, executor: Any) -> None:
        self.bindings = bindings
        self._context = context
        self._node = node
        self._executor = executor

    @classmethod
    def join(cls, bindings: _Bindings, domain: int | None) -> _Joined:
        """By default the environment's domain. Raises FEED_UNREACHABLE."""
        rclpy = bindings.rclpy
        context = rclpy.context.Context()
        try:
            # Not rclpy.init: that would take our signals; and without logging nothing is written to ~/.ros/log.
            context.init(args=[], initialize_logging=False, domain_id=domain)
            node = rclpy.node.Node(
                NODE_NAME,
                context=context,
                enable_rosout=False,
                start_parameter_services=False,
                parameter_overrides=[rclpy.parameter.Parameter("start_type_description_service", value=False)],
            )
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(node)
        except Exception as error:
            context.try_shutdown()
            detail = (
                f"The ROS 2 graph cannot be joined: {type(error).__name__}: {_cut(error)}. Check RMW_IMPLEMENTATION "
                "and ROS_DOMAIN_ID, and whether `ros2 topic list` works in this terminal."
            )
            raise BlockRobotError("FEED_UNREACHABLE", detail) from error
        return cls(bindings, context, node, executor)

    def advertised(self) -> dict[str, str]:
        found = {}
        for topic, types in self._node.get_topic_names_and_types():
            own_count = int(topic == OWN_TOPIC)
            if types and self._node.count_publishers(topic) > own_count:
                found[str(topic)] = str(sorted(types)[0])
        return found

    def discover(self) -> dict[str, str]:
        discovery = Discovery(time.monotonic())
        while not discovery.is_known(self.advertised(), time.monotonic()):
            time.sleep(DISCOVERY_POLL_S)
        return discovery.found

    def publishers(self, topic: str) -> list[_Publisher]:
        reliable = self.bindings.rclpy.qos.ReliabilityPolicy.RELIABLE
        found = []
        for info in self._node.get_publishers_info_by_topic(topic):
            told = getattr(info, "topic_type_hash", None)
            type_hash = str(told) if told is not None and getattr(told, "version", -1) > 0 else ""
            found.append(_Publisher(info.topic_type, info.qos_profile.reliability == reliable, type_hash))
        return found

    def subscribe(self, topic: str, wish: _Heard, listener: Listener) -> Any:
        """Raw bytes, volatile; best effort only if a publisher requires it, since it loses large messages."""
        qos, events = self.bindings.rclpy.qos, self.bindings.rclpy.event_handler
        reliability = qos.ReliabilityPolicy.RELIABLE if wish.is_reliable else qos.ReliabilityPolicy.BEST_EFFORT
        profile = qos.QoSProfile(
            history=qos.HistoryPolicy.KEEP_LAST,
            depth=IMAGE_QUEUE_MAX_COUNT if wish.type in IMAGE_TYPES else QUEUE_MAX_COUNT,
            reliability=reliability,
            durability=qos.DurabilityPolicy.VOLATILE,
        )

        def hear(data: bytes) -> None:
            listener.deliver(Message(topic, wish.type, time.time_ns(), data))

        def lose(info: Any) -> None:
            listener.miss(topic, info.total_count_change)

        wanted = self.bindings.find(topic, wish.type).python_class
        for callbacks in (
            events.SubscriptionEventCallbacks(message_lost=lose, use_default_callbacks=False),
            events.SubscriptionEventCallbacks(use_default_callbacks=False),
        ):
            try:
                return self._node.create_subscription(wanted, topic, hear, profile, raw=True, event_callbacks=callbacks)
            except events.UnsupportedEventTypeError:  # not every middleware counts what it loses
                continue
        raise BlockRobotError("FEED_LOST", f"The topic {topic} cannot be subscribed.")

    def unsubscribe(self, subscription: Any) -> None:
        self._node.destroy_subscription(subscription)

    def spin(self, limit_s: float) -> None:
        self._executor.spin_once(timeout_sec=limit_s)

    def leave(self) -> None:
        for step in (self._executor.shutdown, self._node.destroy_node, self._context.try_shutdown):
            try:
                step()
            except Exception as error:  # noqa: BLE001 - what cannot be left in good order is left all the same
                _log.debug("rclpy did not close in good order: %s", error)
