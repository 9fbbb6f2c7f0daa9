"""`blockrobot lab hosts` without what it needs; and nginx takes the configuration that is shipped."""

from __future__ import annotations

import json
import os
import socket
import ssl
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import IO

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.bench import nginx
from network.bench.nginx import Nginx, configure, count_bodies_on_disk, find_nginx, trust_proxy
from network.cli.main import main
from network.lab.hosts import namespaces, remote_program
from network.lab.hosts.catalogue import STORIES
from network.lab.hosts.founded_network import FoundedNetwork
from network.lab.hosts.namespaces import Host
from network.lab.hosts.remote_program import RemoteProgram
from network.provisioning.network_layout import create_network
from node.config import load_config
from tests.cluster.network_under_test import find_base_port

UPSTREAM_MAX_S = 20
BODY = b"x" * 96 * 1024


def test_without_a_story_they_are_listed() -> None:
    listed = json.loads(CliRunner().invoke(main, ["lab", "hosts", "--json"]).stdout)
    assert list(listed["stories"]) == list(STORIES)
    shown = CliRunner().invoke(main, ["lab", "hosts"]).stdout
    assert all(summary in shown for summary in listed["stories"].values())
    assert CliRunner().invoke(main, ["lab", "hosts", "nonesuch"]).exit_code == 2


def test_who_is_not_root_is_told_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    result = CliRunner().invoke(main, ["lab", "hosts", "liar", "--json"])
    error = json.loads(result.stdout)["error"]
    assert (result.exit_code, error["code"]) == (1, "HOSTS_UNAVAILABLE")
    assert "sudo blockrobot lab hosts" in error["next_step"]


def test_a_machine_without_namespaces_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setenv("PATH", "/nowhere")
    result = CliRunner().invoke(main, ["lab", "hosts", "liar", "--json"])
    assert json.loads(result.stdout)["error"]["code"] == "HOSTS_UNAVAILABLE"


def test_a_changed_configuration_is_not_filled_in_by_halves(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(nginx, "SHIPPED", tmp_path / "blockrobot.conf")
    with pytest.raises(BlockRobotError, match="is not there"):
        configure("127.0.0.1:1", "127.0.0.1:2", "ward", tmp_path)
    nginx.SHIPPED.write_text("server { listen 443 ssl; }")
    with pytest.raises(BlockRobotError, match="has no"):
        configure("127.0.0.1:1", "127.0.0.1:2", "ward", tmp_path)


def test_the_proxy_is_trusted_and_the_rest_of_the_settings_stays(tmp_path: Path) -> None:
    create_network(tmp_path, nodes=1, organisations=1, base_port=find_base_port(1))
    data_dir = tmp_path / "nodes" / "node-1"
    before = load_config(data_dir)
    trust_proxy(data_dir, "127.0.0.1")
    assert load_config(data_dir) == replace(before, trusted_proxies=("127.0.0.1/32",))


def test_a_command_of_namespaces_that_does_not_end_is_an_error_with_a_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    slow = tmp_path / "ip"
    slow.write_text("#!/bin/sh\nexec sleep 60\n")
    slow.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(namespaces, "COMMAND_MAX_S", 0.1)
    with pytest.raises(BlockRobotError, match=r"^HOSTS_UNAVAILABLE.*did not end"):
        Host("one", "brn-none", "10.77.0.1", tmp_path).cut(off=True)


class Local(FoundedNetwork):
    """One host, this machine, with no network of its own."""

    def __init__(self, program: str) -> None:
        self.program = program

    def spawn(
        self, host: Host, module: str, *arguments: str, stderr: int | IO[str] = subprocess.PIPE
    ) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", self.program]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=stderr, text=True, cwd=host.home)


def test_a_program_elsewhere_may_say_much_on_standard_error_and_has_to_answer_in_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    host = Host("visitor", "none", "10.77.0.1", tmp_path)
    talks = (
        "import sys; sys.stderr.write('e' * 2**20 + 'the end'); sys.stderr.flush(); print(input()); sys.stdin.read()"
    )
    with RemoteProgram(Local(talks), host, "talks") as program:
        assert program.ask() == "{}\n"
        with pytest.raises(BlockRobotError, match=r"^HOSTS_STORY_FAILED.*talks.*the end"):
            program.end()
    monkeypatch.setattr(remote_program, "ANSWER_MAX_S", 0.2)
    hangs = Local("import time; time.sleep(60)")
    with (
        pytest.raises(BlockRobotError, match=r"said nothing within 0.2 s"),
        RemoteProgram(hangs, host, "hangs") as program,
    ):
        program.ask()


@pytest.mark.system_packages
def test_what_nginx_does_not_take_is_quoted(tmp_path: Path) -> None:
    assert subprocess.run([find_nginx(), "-v"], capture_output=True, check=False).returncode == 0
    with pytest.raises(BlockRobotError, match="unknown directive"), Nginx(tmp_path / "nginx", "nonsense on;"):
        pass


def post(port: int, declared: int) -> ssl.SSLSocket:
    """A request with this body, or the beginning of it."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    caller = context.wrap_socket(socket.create_connection(("127.0.0.1", port), UPSTREAM_MAX_S))
    caller.sendall(b"POST /v1/transactions HTTP/1.1\r\nHost: n\r\nContent-Length: %d\r\n\r\n" % declared + BODY)
    return caller


@pytest.mark.system_packages
@pytest.mark.parametrize("buffered", [False, True])
def test_a_body_goes_to_the_node_and_to_no_disk_of_the_proxy(tmp_path: Path, *, buffered: bool) -> None:
    port = find_base_port(1)
    create_network(tmp_path / "network", nodes=1, organisations=1, base_port=port)
    keys = tmp_path / "network" / "nodes" / "node-1" / "keys"
    with socket.create_server(("127.0.0.1", 0)) as node:
        node.settimeout(UPSTREAM_MAX_S)
        text = configure(f"127.0.0.1:{node.getsockname()[1]}", f"127.0.0.1:{port}", "localhost", keys)
        if buffered:
            text = text.replace("proxy_request_buffering off;", "")
        with Nginx(tmp_path / "nginx", text), post(port, len(BODY)) as caller:
            node.accept()[0].close()
            assert count_bodies_on_disk(tmp_path / "nginx") == buffered
            if buffered:
                return
            caller.close()
            with post(port, 2 * len(BODY)) as slow, node.accept()[0] as asked:
                asked.sendall(b"HTTP/1.1 408 Too slow\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                assert slow.recv(12) == b"HTTP/1.1 408", "the node's deadline ends half a body, and its sender is told"
