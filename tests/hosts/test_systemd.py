"""The units, started: a system of its own, booted by systemd-nspawn, where a node runs, is killed, backed up, stopped."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.deploy.tools import DEPLOY, ROOT, make

IMAGE = ROOT / "build" / "image"
PYTHON = "/usr/bin/python3"
BOOT_MAX_S = 300
pytestmark = [pytest.mark.timeout(1_800), pytest.mark.system_packages]

STORY = """#!/bin/bash
exec > /story 2>&1
blockrobot() { runuser -u blockrobot -- env BLOCKROBOT_HOME=/var/lib/blockrobot /opt/blockrobot/.venv/bin/blockrobot "$@"; }
ready() {
    for i in $(seq 60); do
        python3 -c "import urllib.request; urllib.request.urlopen('http://127.0.0.1:7274/readyz')" 2> /dev/null && return
        sleep 1
    done
    false
}
hidden() {
    found=$(nsenter --mount --target "$(systemctl show --property=MainPID --value blockrobot-node@ward-1)" \\
        ls -A /var/lib/blockrobot/network/organisations) && test -z "$found"
}
tell() { "${@:2}" > /told 2>&1; echo "$1=$?"; cat /told; }
cd /var/lib/blockrobot
blockrobot org new hospital
blockrobot node init ward-1 --founding --organisation hospital --custodian --base-port 7272
blockrobot genesis make network/*/*/*-entry.json --out genesis.json
blockrobot genesis check genesis.json --adopt
tell enabled systemctl enable --now blockrobot-node@ward-1 blockrobot-backup@ward-1.timer
tell ready ready
tell hidden hidden
tell timer systemctl is-active blockrobot-backup@ward-1.timer
tell backup systemctl start blockrobot-backup@ward-1
tell reload systemctl reload blockrobot-node@ward-1
systemctl kill --signal=KILL blockrobot-node@ward-1
sleep 6
tell ready_again ready
tell stopped systemctl stop blockrobot-node@ward-1
systemctl show --property=Result blockrobot-node@ward-1
journalctl --no-pager --unit='blockrobot*' > /journal
poweroff
"""
SERVICE = """[Unit]
After=multi-user.target
[Service]
Type=exec
ExecStart=/story.sh
"""


@pytest.fixture
def system(tmp_path: Path) -> Path:
    """A Debian with the program of the image, the units, and the story that it plays at its start."""
    make("image", PYTHON)
    root, bundle = tmp_path / "root", tmp_path / "bundle"
    units = root / "etc" / "systemd" / "system"
    packages = "--include=systemd,systemd-sysv,dbus,passwd,python3"
    for command in (
        ["mmdebstrap", "--quiet", "--variant=essential", packages, "bookworm", root],
        ["umoci", "unpack", "--image", f"{IMAGE}:latest", bundle],
        ["cp", "-a", bundle / "rootfs" / "opt" / "blockrobot", root / "opt"],
        ["cp", *(DEPLOY / "systemd").iterdir(), units],
        ["chroot", root, "useradd", "--system", "--home-dir", "/var/lib/blockrobot", "blockrobot"],
        [
            "chroot",
            root,
            "install",
            "-d",
            "-m",
            "0700",
            "-o",
            "blockrobot",
            "/var/lib/blockrobot",
            "/var/backups/blockrobot",
        ],
    ):
        subprocess.run(command, check=True, capture_output=True)
    (root / "story.sh").write_text(STORY)
    (root / "story.sh").chmod(0o755)
    (units / "story.service").write_text(SERVICE)
    wanted = units / "multi-user.target.wants"
    wanted.mkdir(exist_ok=True)
    (wanted / "story.service").symlink_to("../story.service")
    return root


def test_a_node_is_run_started_again_backed_up_and_stopped_by_its_units(system: Path) -> None:
    boot = ["systemd-nspawn", "--quiet", "--directory", system, "--boot", "--private-network", "--register=no"]
    subprocess.run(
        [*boot, "--keep-unit", "--console=pipe"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=BOOT_MAX_S,
        check=False,
    )
    story = (system / "story").read_text()
    told = dict(
        line.split("=", 1) for line in story.splitlines() if line.partition("=")[0].isidentifier() and "=" in line
    )
    steps = dict.fromkeys(("enabled", "ready", "hidden", "timer", "backup", "reload", "ready_again", "stopped"), "0")
    assert told.items() >= steps.items(), story + (system / "journal").read_text()
    assert told["Result"] == "success"
    (backup,) = (system / "var" / "backups" / "blockrobot").glob("ward-1-*/backup.json")
    assert not list(backup.parent.rglob("*.key"))
    logged = system / "var" / "lib" / "blockrobot" / "network" / "nodes" / "ward-1" / "node.log"
    events: list[dict[str, Any]] = [json.loads(line) for line in logged.read_text().splitlines()]
    assert [event["event"] for event in events].count("node_started") == 2
    assert not [event for event in events if event["event"] == "contract_sandbox_incomplete"]
