"""ROS 1 live feed by rospy, undecoded messages.

rospy is kept from signals, logs, printing, and non-local listening with a local master. One ROS 1 node per process,
once.
"""

from __future__ import annotations

import atexit
import importlib
import importlib.util
import logging
import os
import re
import sys
import threading
import time
import xmlrpc.client
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

import click

from clients.robot.sources.live.live_feed import CLOSE_MAX_S, MESSAGE_MAX_BYTES, NODE_NAME, Feed, Listener
from clients.robot.sources.messages.message_types import Message
from consensus.errors import BlockRobotError

MASTER_DEFAULT_URI = "http://127.0.0.1:11311"
DEBIAN_FOLDER = Path("/usr/lib/python3/dist-packages")
BUFFER_BYTES = 1 << 20
OPEN_MAX_S = 10.0
MASTER_ANSWER_MAX_S = 3.0
ROLL_CALL_EVERY_S = 2.0
NAME_MAX_CHARS = 256
LOOPBACK_HOSTS = ("127.0.0.1", "localhost", "::1")
LOGGERS = ("rospy", "rosout", "rosgraph", "rosmaster", "roslib", "topic")
Answer = TypeVar("Answer")
_TYPE = re.compile(r"([A-Za-z]\w*)/([A-Za-z]\w*)", re.ASCII)
_INSTALL = (
    "On Debian: sudo apt-get install --no-install-recommends python3-rospy python3-sensor-msgs; that is found by itself. "
    "With a ROS distribution: source its setup.bash first, or name the folder that has rospy with --ros-path."
)


def _is_master_uri(uri: str) -> bool:
    try:
        parts = urlsplit(uri)
        return bool(parts.scheme == "http" and parts.hostname and parts.port)
    except ValueError:
        return False


def _no_master(uri: str) -> str:
    return f"{uri[:NAME_MAX_CHARS]} is no address of a ROS 1 master, as {MASTER_DEFAULT_URI}."


def _check_master(_context: click.Context, _parameter: click.Parameter, uri: str | None) -> str | None:
    if uri is not None and not _is_master_uri(uri):
        raise click.BadParameter(_no_master(uri))
    return uri


OPTIONS = (
    click.option(
        "--ros-master",
        metavar="URI",
        callback=_check_master,
        help="The ROS 1 master. [default: ROS_MASTER_URI, or this machine's]",
    ),
    click.option(
        "--ros-path",
        type=click.Path(path_type=Path, file_okay=False, exists=True),
        help="The folder that has rospy, if Python does not find it. [default: Debian's]",
    ),
)


def make_feeds(options: Mapping[str, Any]) -> Sequence[Feed]:
    uri = options.get("ros_master") or os.environ.get("ROS_MASTER_URI") or MASTER_DEFAULT_URI
    return [Ros1Feed(uri, options.get("ros_path") or DEBIAN_FOLDER)]


def ros_type(name: str) -> str:
    """Return `pkg/Name` as `pkg/msg/Name`, empty if invalid."""
    found = _TYPE.fullmatch(name) if len(name) <= NAME_MAX_CHARS else None
    return f"{found[1]}/msg/{found[2]}" if found else ""


class Ros1Feed:
    """A ROS 1 master's topics; `folder`: fallback location of rospy."""

    ros1 = True

    def __init__(self, master_uri: str, folder: Path = DEBIAN_FOLDER) -> None:
        self._master = Master(master_uri)
        self.name = f"The ROS 1 master at {master_uri}"
        self._folder = folder
        self._rospy: Any = None
        self._listener: Listener | None = None
        self._subscribers: list[Any] = []
        self._topics: tuple[str, ...] = ()
        self._closing = threading.Event()
        self._roll_call = threading.Thread(target=self._reregister_loop, name="ros1-roll-call", daemon=True)

    def topics(self) -> dict[str, str]:
        """Raises FEED_UNREACHABLE."""
        return self._master.published()

    def open(self, wanted: Mapping[str, str], listener: Listener) -> None:
        """Raises FEED_UNREACHABLE, MIDDLEWARE_MISSING."""
        self._rospy = import_rospy(self._folder)
        self._listener = listener
        self._topics = tuple(wanted)
        self._master.published()
        _within(OPEN_MAX_S, self._subscribe, self._master.uri)
        self._roll_call.start()

    def close(self) -> None:
        self._closing.set()
        if self._rospy is None:
            return
        leaving = threading.Thread(target=self._rospy.signal_shutdown, args=("closed",), daemon=True)
        leaving.start()
        leaving.join(CLOSE_MAX_S / 2)
        if self._roll_call.ident is not None:
            self._roll_call.join(CLOSE_MAX_S / 2)

    def _subscribe(self) -> None:
        _join(self._rospy, self._master.uri)
        for topic in self._topics:
            settings = {"callback_args": topic, "buff_size": BUFFER_BYTES, "tcp_nodelay": True}
            self._subscribers.append(self._rospy.Subscriber(topic, self._rospy.AnyMsg, self._hear, **settings))

    def _hear(self, message: Any, topic: str) -> None:
        """Deliver a message; never raises, since rospy would print it."""
        listener = self._listener
        if listener is None or self._closing.is_set():
            return
        at_ns = time.time_ns()
        header = message._connection_header
        # Two nodes may disagree about a type, and each has a thread of its own here.
        type_name, definition = ros_type(str(header.get("type", ""))), str(header.get("message_definition", ""))
        listener.deliver(Message(topic, type_name, at_ns, bytes(message._buff or b"")), definition)

    def _reregister_loop(self) -> None:
        """Reregister after a master restart; a node shut down stays deaf."""
        while not self._closing.wait(ROLL_CALL_EVERY_S):
            if self._rospy.is_shutdown():
                if self._listener is not None and not self._closing.is_set():
                    detail = (
                        "Somebody on the ROS 1 graph has shut this node down, as `rosnode kill` does. Start it again."
                    )
                    self._listener.fail(BlockRobotError("FEED_LOST", detail))
                return
            with suppress(Exception):  # the master is away, or no master any more; what is connected goes on
                node = self._rospy.get_name()
                missing = set(self._topics) - self._master.subscribed(node)
                for topic in sorted(missing) if not self._closing.is_set() else ():
                    publishers = self._master.subscribe(node, topic, self._rospy.get_node_uri())
                    with _proxy(self._rospy.get_node_uri()) as own:
                        own.publisherUpdate("/master", topic, publishers)


class Master:
    """A ROS 1 master; calls raise FEED_UNREACHABLE after `MASTER_ANSWER_MAX_S`."""

    def __init__(self, uri: str) -> None:
        self.uri = uri
        if not _is_master_uri(uri):
            raise BlockRobotError("FEED_UNREACHABLE", _no_master(uri))

    def published(self) -> dict[str, str]:
        return self._ask(_read_topics, "getPublishedTopics", f"/{NODE_NAME}", "")

    def subscribed(self, node: str) -> set[str]:
        def read(answer: Any) -> set[str]:
            _, subscribers, _ = answer
            return {str(topic) for topic, nodes in subscribers if node in nodes}

        return self._ask(read, "getSystemState", node)

    def subscribe(self, node: str, topic: str, node_uri: str) -> list[str]:
        """Return the topic's publisher addresses."""
        return self._ask(_read_uris, "registerSubscriber", node, topic, "*", node_uri)

    def _ask(self, read: Callable[[Any], Answer], method: str, *arguments: str) -> Answer:
        try:
            with _proxy(self.uri) as master:
                code, status_text, answer = getattr(master, method)(*arguments)
            if code == 1:
                return read(answer)
        except Exception as error:  # what is no master answers in many ways
            raise BlockRobotError(
                "FEED_UNREACHABLE",
                f"No ROS 1 master answers at {self.uri}. Start it (roscore), or name it with --ros-master URI.",
            ) from error
        raise BlockRobotError("FEED_UNREACHABLE", f"The ROS 1 master at {self.uri} refuses: {str(status_text)[:200]}.")


def _read_topics(answer: Any) -> dict[str, str]:
    return {str(topic): ros_type(str(kind)) for topic, kind in answer}


def _read_uris(answer: Any) -> list[str]:
    return [str(uri) for uri in answer]


class _Transport(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> HTTPConnection:
        connection = HTTPConnection(host, timeout=MASTER_ANSWER_MAX_S)
        self._connection = host, connection  # `close` looks for it here
        return connection


def _proxy(uri: str) -> xmlrpc.client.ServerProxy:
    return xmlrpc.client.ServerProxy(uri, transport=_Transport())


def import_rospy(folder: Path) -> Any:
    """Return rospy, restricted; `folder` comes last on the path. Raises MIDDLEWARE_MISSING."""
    loggers = logging.getLoggerClass()
    added = [str(folder)] if importlib.util.find_spec("rospy") is None and str(folder) not in sys.path else []
    sys.path.extend(added)
    try:
        rospy = importlib.import_module("rospy")
        importlib.import_module("rospy.core")
        talkative = [importlib.import_module(f"rospy.impl.{name}") for name in ("registration", "masterslave")]
        transport = importlib.import_module("rospy.impl.tcpros_base")
    except ImportError as error:
        for name in added:
            sys.path.remove(name)
        status_text = (
            f"Python {sys.version_info.major}.{sys.version_info.minor} cannot import rospy ({error}). {_INSTALL}"
        )
        raise BlockRobotError("MIDDLEWARE_MISSING", status_text) from error
    finally:
        logging.setLoggerClass(loggers)
    rospy.core.configure_logging = lambda *_, **__: None  # it would write files, and take the loggers of others over
    for module in talkative:
        vars(module)["print"] = lambda *_: None  # they speak to standard output, which is ours
    _bound_messages(transport)
    atexit.unregister(rospy.core._ros_atexit)
    for name in LOGGERS:
        logging.getLogger(name).addHandler(logging.NullHandler())
        logging.getLogger(name).propagate = False
    return rospy


def _bound_messages(transport: Any) -> None:
    """End connections that exceed the message size; rospy itself has no limit."""
    receive = transport.recv_buff

    def receive_bounded(connection: Any, buffer: Any, count: int) -> int:
        if buffer.tell() > MESSAGE_MAX_BYTES:
            raise transport.TransportTerminated("a message is too large")
        return int(receive(connection, buffer, count))

    transport.recv_buff = receive_bounded


def _join(rospy: Any, master_uri: str) -> None:
    os.environ["ROS_MASTER_URI"] = master_uri
    if urlsplit(master_uri).hostname in LOOPBACK_HOSTS and not {"ROS_IP", "ROS_HOSTNAME"} & os.environ.keys():
        os.environ["ROS_IP"] = LOOPBACK_HOSTS[0]
    rospy.init_node(NODE_NAME, argv=[], anonymous=True, disable_signals=True, disable_rosout=True, disable_rostime=True)


def _within(limit_s: float, what: Callable[[], None], uri: str) -> None:
    """A possibly endless call, in a thread. Raises FEED_UNREACHABLE."""
    failures: list[Exception] = []

    def do() -> None:
        try:
            what()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is raised in the caller's thread
            failures.append(error)

    doing = threading.Thread(target=do, daemon=True)
    doing.start()
    doing.join(limit_s)
    if doing.is_alive() or failures:
        why = f": {failures[0]}" if failures else f" within {limit_s:g} s"
        raise BlockRobotError("FEED_UNREACHABLE", f"The ROS 1 graph of {uri} could not be joined{why}.")
