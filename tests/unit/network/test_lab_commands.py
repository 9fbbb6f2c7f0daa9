"""`blockrobot lab hosts` without what it needs; and nginx takes the configuration that is shipped."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.bench import nginx
from network.bench.nginx import Nginx, configure, find_nginx, trust_proxy
from network.cli.main import main
from network.lab.hosts.catalogue import STORIES


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


def test_the_proxy_is_trusted_by_one_line(tmp_path: Path) -> None:
    config = tmp_path / "node.toml"
    config.write_text('[node]\nname = "a"\n\n[listen]\nhost = "127.0.0.1"\n')
    trust_proxy(config, "127.0.0.1")
    assert config.read_text().splitlines()[3:5] == ["[listen]", 'trusted_proxies = ["127.0.0.1"]']


@pytest.mark.system_packages
def test_what_nginx_does_not_take_is_quoted(tmp_path: Path) -> None:
    assert subprocess.run([find_nginx(), "-v"], capture_output=True, check=False).returncode == 0
    with pytest.raises(BlockRobotError, match="unknown directive"), Nginx(tmp_path / "nginx", "nonsense on;"):
        pass
