"""The role for Ansible, played on hosts: two found a network, a third one joins it, and a second run changes nothing."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from network.lab.hosts.namespaces import Host, Hosts
from tests.deploy.tools import DEPLOY, ROOT, TOOLS, make

FOUNDERS = {"ward-1": "hospital", "lab-1": "university"}
NEWCOMER = "desk-1"
PLAY_MAX_S = 900
PYTHON = "/usr/bin/python3"
pytestmark = [pytest.mark.timeout(2 * PLAY_MAX_S), pytest.mark.system_packages]

ENTER = """#!/bin/sh
exec ip netns exec {namespace} unshare --mount sh -c '
for place in etc srv opt var/backups; do mount --bind {home}/$place /$place; done
exec /bin/sh "$@"' sh "$@"
"""
"""The shell of a host: with a network, users, programs and data of its own."""


class Fleet:
    """Hosts, and an administrator who plays the playbook on them."""

    def __init__(self, hosts: dict[str, Host], place: Path) -> None:
        self.hosts = hosts
        self.place = place
        self.exchange = place / "exchange"
        self.exchange.mkdir()
        programs = place / "opt"
        programs.mkdir()
        for name, host in hosts.items():
            shutil.copytree("/etc", host.home / "etc", symlinks=True)
            for folder in ("srv", "var/backups"):
                (host.home / folder).mkdir(parents=True)
            (host.home / "opt").symlink_to(programs)  # as on a file system that all mount
            self.shell(name).write_text(ENTER.format(namespace=host.namespace, home=host.home))
            self.shell(name).chmod(0o755)
        self._write_inventory()

    def shell(self, name: str) -> Path:
        return self.place / f"shell-{name}"

    def _write_inventory(self) -> None:
        own = {
            name: {"ansible_host": host.address, "ansible_shell_executable": str(self.shell(name))}
            for name, host in self.hosts.items()
        }
        own[NEWCOMER] |= {"blockrobot_organisation": "clinic"}
        own["ward-1"] |= {"blockrobot_wheelhouse": str(ROOT / "build" / "wheelhouse")}  # for all: they share /opt
        own["ward-1"] |= {"blockrobot_custodian": True}
        common = {
            "ansible_connection": "local",
            "ansible_python_interpreter": PYTHON,
            "blockrobot_python": PYTHON,
            "blockrobot_founding_nodes": FOUNDERS,
            "blockrobot_exchange": str(self.exchange),
            "blockrobot_supervisor": "none",
            "blockrobot_home": "/srv/blockrobot",
        }
        inventory = {"blockrobot_nodes": {"vars": common, "hosts": own}}
        (self.place / "inventory.json").write_text(json.dumps(inventory))

    def play(self, *arguments: str, fails: bool | None = False) -> dict[str, int]:
        """Play it; return how many tasks changed something, by host. `fails`: None for either."""
        environment = {
            **os.environ,
            "HOME": str(self.place),
            "ANSIBLE_PIPELINING": "1",
            "ANSIBLE_REMOTE_TEMP": str(self.place / "remote"),
            "ANSIBLE_NOCOLOR": "1",
            "LANG": "C.UTF-8",
        }
        done = subprocess.run(
            [
                TOOLS / "bin" / "ansible-playbook", "--inventory", self.place / "inventory.json", "--forks", "1", "--diff",
                DEPLOY / "ansible" / "playbook.yml", *arguments,
            ],
            env=environment, capture_output=True, text=True, timeout=PLAY_MAX_S, check=False,
        )  # fmt: skip
        self.said = done.stdout
        assert fails in (done.returncode != 0, None), (done.stdout + done.stderr)[-6000:]
        recap = done.stdout.partition("PLAY RECAP")[2]
        return {
            name: int(count) for name, count in re.findall(r"^(\S+)\s+: ok=\d+\s+changed=(\d+)", recap, re.MULTILINE)
        }

    def type(self, name: str, *arguments: str) -> dict[str, Any]:
        """What a command answers that the administrator of a host types there."""
        words = ["runuser", "-u", "blockrobot", "--", "env", "BLOCKROBOT_HOME=/srv/blockrobot"]
        typed = " ".join([*words, "/opt/blockrobot/.venv/bin/blockrobot", *arguments, "--json"])
        done = subprocess.run([self.shell(name), "-c", typed], capture_output=True, text=True, cwd="/", check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer

    def bait(self, name: str, path: Path, text: str) -> Path:
        """Put a link there to a new file of root's."""
        target = self.hosts[name].home / "etc" / f"bait-{path.name}"
        target.write_text(text)
        path.unlink()
        path.symlink_to(f"/etc/{target.name}")
        return target

    def agree(self, *proposal: str) -> None:
        """The hospital proposes, the university approves."""
        made = self.type("ward-1", "org", "propose", *proposal, "--as", "hospital")
        self.type("lab-1", "org", "approve", made["proposal"]["id"], "--as", "university")


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    make("build/deploy-tools/.tools")
    make("wheelhouse", PYTHON)
    with Hosts(tmp_path / "hosts", [*FOUNDERS, NEWCOMER]) as hosts:
        yield Fleet(hosts.hosts, tmp_path)


def test_a_fleet_is_founded_grows_and_is_left_alone_once_it_is_as_it_should_be(fleet: Fleet) -> None:
    assert all(fleet.play().values())
    assert "propose add-org" in fleet.said, "the newcomer is told what its organisation needs"
    statuses = {name: fleet.type(name, "status")["nodes"][0] for name in FOUNDERS}
    assert {name: status["peers"] for name, status in statuses.items()} == {"ward-1": ["lab-1"], "lab-1": ["ward-1"]}
    checked = {name: fleet.type(name, "genesis", "check", "/srv/blockrobot/genesis.json") for name in FOUNDERS}
    owned = {owner["name"]: owner["custodians"] for owner in checked["lab-1"]["organisations"]}
    assert owned == {"hospital": ["ward-1"], "university": []}

    # Two hosts make keys for one organisation.
    founders = json.dumps({"blockrobot_founding_nodes": FOUNDERS | {NEWCOMER: "hospital"}})
    fleet.play("--limit", NEWCOMER, "--extra-vars", founders, fails=True)
    assert "name one node of it" in fleet.said
    handed = (fleet.exchange / "organisation-hospital.json").read_bytes()
    fleet.play("--limit", NEWCOMER, "--extra-vars", "blockrobot_organisation=hospital", fails=True)
    assert "two hosts made keys for one organisation" in fleet.said
    assert (fleet.exchange / "organisation-hospital.json").read_bytes() == handed
    shutil.rmtree(fleet.hosts[NEWCOMER].home / "srv" / "blockrobot" / "network" / "organisations" / "hospital")

    # A third organisation is let in, and its node.
    shared = fleet.hosts["ward-1"].home / "srv" / "blockrobot"
    shutil.copy(fleet.exchange / "organisation-clinic.json", shared)
    fleet.agree("add-org", "--from", "/srv/blockrobot/organisation-clinic.json")
    fleet.type("ward-1", "node", "directory", "ward-1", "--out", "/srv/blockrobot/directory.json")
    for path in (shared / "directory.json", shared / "network" / "genesis.json"):
        shutil.copy(path, fleet.exchange)
    assert fleet.play("--limit", NEWCOMER, "--extra-vars", "blockrobot_wait_for=livez")[NEWCOMER]
    shutil.copy(fleet.exchange / f"node-{NEWCOMER}.json", shared)
    fleet.agree("add-node", "--from", f"/srv/blockrobot/node-{NEWCOMER}.json")

    assert fleet.play() == dict.fromkeys(fleet.hosts, 0), fleet.said
    assert fleet.play("--check") == dict.fromkeys(fleet.hosts, 0), fleet.said
    joined = fleet.type(NEWCOMER, "genesis", "check", "/srv/blockrobot/network/genesis.json")
    assert joined["fingerprint"] == checked["ward-1"]["fingerprint"], "also where a node came later"

    # What would change is shown and not done; then it is done, and comes into force.
    level = "--extra-vars={'blockrobot_settings': {'log': {'level': 'warning'}}}"
    settings = fleet.hosts["lab-1"].home / "srv" / "blockrobot" / "network" / "nodes" / "lab-1" / "node.toml"
    before = settings.read_text()
    certificate = settings.parent / "keys" / "tls.crt.pem"
    old = certificate.read_bytes()
    assert fleet.play("--check", "--limit", "lab-1", level)["lab-1"] > 0
    assert 'level = "warning"' in fleet.said
    assert settings.read_text() == before
    bait = fleet.bait("lab-1", settings, before)
    fleet.play("--limit", "lab-1", level, "--extra-vars", "blockrobot_renew_days=1000")
    assert (bait.read_text(), bait.stat().st_uid, settings.is_symlink()) == (before, 0, False), "no link leads root"
    assert 'level = "warning"' in settings.read_text()
    assert certificate.read_bytes() != old, "it is renewed in time"
    assert fleet.type("ward-1", "settings", "propose", "heartbeat_ms", "20000")["height"] > 0, "it goes on"

    # A node that was taken over links to what only root reads or writes.
    node = settings.parent
    handed = (fleet.exchange / "node-lab-1.json").read_bytes()
    entry = node / "node-entry.json"
    kept = entry.read_text()
    fleet.bait("lab-1", entry, kept).chmod(0o600)
    fleet.play("--limit", "lab-1", fails=True)
    assert "Too many levels of symbolic links" in fleet.said
    entry.unlink()
    for wrong in (kept.replace("lab-1", "ward-1"), kept.replace('"admin"', '"key"'), " " * 2**16 + kept):
        entry.write_text(wrong)
        fleet.play("--limit", "lab-1", fails=True)
        assert "Whether it is the node's entry" in fleet.said.rpartition("TASK [")[2]
    assert (fleet.exchange / "node-lab-1.json").read_bytes() == handed
    entry.write_text(kept)
    shared_by_root = fleet.hosts["lab-1"].home / "etc" / "theirs"
    network = node.parents[1]
    shutil.move(network, shared_by_root)
    network.symlink_to("/etc/theirs")
    os.chown(shared_by_root, 0, 0)
    fleet.play("--limit", "lab-1", fails=None)
    assert shared_by_root.stat().st_uid == 0
    (fleet.exchange / "genesis.json").unlink()
    (fleet.exchange / "genesis.json").symlink_to(bait)
    fleet.play("--limit", "lab-1", fails=True)
    assert "and no link" in fleet.said

    # No key of anybody came to the administrator's machine.
    homes = [host.home / place for host in fleet.hosts.values() for place in ("srv", "etc/theirs")]
    secrets = [path.read_bytes() for home in homes for path in home.rglob("*.key*")]
    assert len(secrets) >= 4 * len(fleet.hosts)
    handed = [path.read_bytes() for path in fleet.exchange.iterdir()]
    assert not [one for one in secrets if any(one in text or one.hex().encode() in text for text in handed)]
