"""What of ROS 1 needs no ROS 1: names of types, addresses of masters, and what to do where rospy is not installed."""

from __future__ import annotations

import contextlib
import sys
import threading
import xmlrpc.client
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from clients.robot.sources.live.ros1 import MASTER_DEFAULT_URI, Master, Ros1Feed, import_rospy, make_feeds, ros_type
from consensus.errors import BlockRobotError


@pytest.mark.parametrize(
    ("told", "found"),
    [
        ("sensor_msgs/Image", "sensor_msgs/msg/Image"),
        ("ward_msgs/TagArray2", "ward_msgs/msg/TagArray2"),
        ("*", ""),
        ("", ""),
        ("a/b/c", ""),
        ("a/b\nuint8 x", ""),
        ("ä/Tag", ""),
        ("a/" + "b" * 300, ""),
    ],
)
def test_a_type_of_ros_1_has_one_name_here_and_what_is_none_has_none(told: str, found: str) -> None:
    assert ros_type(told) == found


@pytest.mark.parametrize(
    "uri", ["", "localhost:11311", "https://host:1", "http://host", "http://host:70000", "http://[::1"]
)
def test_what_is_no_address_of_a_master_is_refused_with_one_that_is(uri: str) -> None:
    with pytest.raises(BlockRobotError) as refused:
        Master(uri)
    assert refused.value.code == "FEED_UNREACHABLE"
    assert MASTER_DEFAULT_URI in refused.value.detail


def test_the_master_is_the_options_else_the_environments_else_this_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_MASTER_URI", raising=False)

    def chosen(**options: str) -> str:
        (feed,) = make_feeds(options)
        assert isinstance(feed, Ros1Feed)
        return feed._master.uri

    assert chosen() == MASTER_DEFAULT_URI
    monkeypatch.setenv("ROS_MASTER_URI", "http://192.0.2.7:11311")
    assert chosen() == "http://192.0.2.7:11311"
    assert chosen(ros_master="http://192.0.2.8:11311") == "http://192.0.2.8:11311"


def test_where_rospy_is_not_installed_the_command_that_installs_it_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "rospy", None)
    before = list(sys.path)
    with pytest.raises(BlockRobotError) as refused:
        import_rospy(tmp_path)
    assert refused.value.code == "MIDDLEWARE_MISSING"
    assert "apt-get install --no-install-recommends python3-rospy python3-sensor-msgs" in refused.value.detail
    assert "--ros-path" in refused.value.detail
    assert sys.path == before


def test_a_feed_that_was_never_opened_can_be_closed_twice() -> None:
    feed = Ros1Feed(MASTER_DEFAULT_URI)
    feed.close()
    feed.close()


@contextlib.contextmanager
def answering(body: bytes) -> Iterator[str]:
    """An HTTP server that gives the same answer to every call; yields its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/xml")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    serving = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    serving.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        serving.join()
        server.server_close()


@pytest.mark.parametrize(
    "body",
    [
        b"<html><br></html>",
        b"",
        b"\xff\xfe",
        xmlrpc.client.dumps(([1, "", 7],), methodresponse=True).encode(),
        xmlrpc.client.dumps((7,), methodresponse=True).encode(),
        xmlrpc.client.dumps(([0, "no", ""],), methodresponse=True).encode(),
    ],
)
def test_what_answers_and_is_no_master_is_told_as_one_that_cannot_be_reached(body: bytes) -> None:
    with answering(body) as uri:
        master = Master(uri)
        for ask in (master.published, lambda: master.subscribed("/n"), lambda: master.subscribe("/n", "/t", uri)):
            with pytest.raises(BlockRobotError) as refused:
                ask()
            assert refused.value.code == "FEED_UNREACHABLE"
            assert uri in refused.value.detail


def test_a_master_whose_list_of_topics_has_a_row_too_short_is_no_master() -> None:
    rows = xmlrpc.client.dumps(([1, "", [["/topic"]]],), methodresponse=True).encode()
    with answering(rows) as uri, pytest.raises(BlockRobotError, match="FEED_UNREACHABLE"):
        Master(uri).published()
