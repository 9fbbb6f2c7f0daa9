"""Which readers and which Zenoh router the options and the topics file name together."""

from __future__ import annotations

import errno
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from clients.robot.sources.live import llrp, zenoh
from clients.robot.sources.live.llrp import _why, parse_address
from clients.robot.sources.messages.topics import LlrpReader
from consensus.errors import BlockRobotError


class Silence:
    """A listener that is told nothing."""

    def fail(self, error: BlockRobotError) -> None:
        raise AssertionError(error)


TABLES = '[[llrp]]\nhost = "10.0.0.7"\nfront = [1]\n[[llrp]]\nhost = "10.0.0.8"\n'


@pytest.mark.parametrize(
    ("text", "reader"),
    [
        ("10.0.0.7", LlrpReader("10.0.0.7")),
        ("reader.local:15084", LlrpReader("reader.local", 15_084)),
        ("[fe80::1]:15084", LlrpReader("fe80::1", 15_084)),
        ("[fe80::1]", LlrpReader("fe80::1")),
    ],
)
def test_an_address_has_a_host_and_perhaps_a_port(text: str, reader: LlrpReader) -> None:
    assert parse_address(text) == reader


@pytest.mark.parametrize("text", ["", ":5084", "host:", "host:0", "host:70000", "host:١", "host:x", "[]:5084"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        parse_address(text)


@pytest.fixture
def topics_file(tmp_path: Path) -> Path:
    """A topics file that names two readers."""
    path = tmp_path / "topics.toml"
    path.write_text(TABLES, encoding="utf-8")
    return path


def asked(readers: list[LlrpReader], topics_file: Path | None, monkeypatch: pytest.MonkeyPatch) -> list[LlrpReader]:
    """The readers that would be asked."""
    found: list[LlrpReader] = []
    monkeypatch.setattr(llrp, "LlrpFeed", lambda these: found.extend(these) or these)
    llrp.make_feeds({"llrp_readers": readers, "topics_file": topics_file})
    return found


def test_readers_are_those_of_the_option_or_else_of_the_topics_file(
    topics_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert asked([], topics_file, monkeypatch) == [LlrpReader("10.0.0.7", front=(1,)), LlrpReader("10.0.0.8")]
    named = [LlrpReader("10.0.0.7"), LlrpReader("10.0.0.9"), LlrpReader("10.0.0.9")]
    assert asked(named, topics_file, monkeypatch) == [LlrpReader("10.0.0.7", front=(1,)), LlrpReader("10.0.0.9")]


def test_without_a_reader_there_is_no_feed_and_zenohs_options_name_routers_and_domain() -> None:
    assert llrp.make_feeds({"llrp_readers": [], "topics_file": None}) == []
    told = parsed("--zenoh-connect", "tcp/10.0.0.2:7447", "--zenoh-connect", "tls/robot.local:7448")
    assert (list(told["zenoh_connect"]), told["ros_domain"]) == (["tcp/10.0.0.2:7447", "tls/robot.local:7448"], 0)
    assert parsed(ROS_DOMAIN_ID="42")["ros_domain"] == 42
    assert parsed("--ros-domain", "7", ROS_DOMAIN_ID="42")["ros_domain"] == 7


def parsed(*arguments: str, **environment: str) -> dict[str, Any]:
    """What Zenoh's options come to."""
    told: dict[str, Any] = {}

    def command(**options: Any) -> None:
        told.update(options)

    for option in zenoh.OPTIONS:
        command = option(command)
    result = CliRunner(env=environment).invoke(click.command()(command), arguments)
    return told or {"refused": result.output}


@pytest.mark.parametrize(
    "endpoint", ["10.0.0.2:7447", "tcp/10.0.0.2", "serial//dev/tty0", "unixsock-stream//x", "tcp/a b:1"]
)
def test_what_is_no_endpoint_of_a_network_is_refused(endpoint: str) -> None:
    assert "is no endpoint of Zenoh" in parsed("--zenoh-connect", endpoint)["refused"]


@pytest.mark.parametrize("domain", ["-1", "233", "x"])
def test_what_is_no_domain_is_refused(domain: str) -> None:
    assert "--ros-domain" in parsed("--ros-domain", domain)["refused"]


@pytest.mark.parametrize(
    ("library", "use", "installs"),
    [
        ("zenoh", lambda: zenoh.ZenohFeed().topics(), "make install-zenoh"),
        ("llrpkit.reader", lambda: llrp.LlrpFeed([LlrpReader("10.0.0.7")]).open({}, Silence()), "make install-llrp"),
    ],
)
def test_where_a_library_is_missing_the_command_that_installs_it_is_named(
    library: str, use: Callable[[], object], installs: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)  # as if it were not installed
    with pytest.raises(BlockRobotError) as caught:
        use()
    assert (caught.value.code, installs in caught.value.detail) == ("MIDDLEWARE_MISSING", True)


def test_neither_library_is_loaded_before_it_is_used() -> None:
    code = "import sys, clients.robot.cli.main; print(sorted({'zenoh', 'llrpkit'} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"


async def test_what_keeps_a_reader_from_answering_is_said_in_plain_words() -> None:
    wrapped = RuntimeError("cannot connect to 192.0.2.1:5084: [Errno 111] Connect call failed ('192.0.2.1', 5084)")
    wrapped.__cause__ = ConnectionRefusedError(errno.ECONNREFUSED, "Connect call failed ('192.0.2.1', 5084)")
    assert _why(wrapped) == "Connection refused"
    assert "within" in _why(TimeoutError())
    assert "is a reader there?" in _why(TimeoutError())
    assert _why(ValueError("M_Already_Exists")) == "M_Already_Exists"
    assert _why(ValueError()) == "ValueError"
