"""A network of four organisations, each with a node on a host of its own, founded by commands typed there."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import network
from clients.registrar.registrar import Registrar
from consensus.bounded_text import read_json_as
from consensus.chain.genesis import Genesis, genesis_from_json
from consensus.errors import BlockRobotError
from network.lab.hosts.namespaces import Host, Hosts
from network.provisioning.network_layout import FIRST_PORT
from node.config import LOOPBACK

ORGANISATIONS = ("clinic", "hospital", "lab", "university")
HOSTS = (*ORGANISATIONS, "visitor", "stranger")
COMMAND_MAX_S = 120
WAIT_MAX_S = 90
POLL_S = 0.2
_READ_STATUS = f"""
import sys, urllib.request
headers = {{"Authorization": "Bearer " + sys.stdin.read()}}
asked = urllib.request.Request("http://{LOOPBACK}:{FIRST_PORT + 2}/status", headers=headers)
sys.stdout.write(urllib.request.urlopen(asked, timeout=5).read().decode())
"""
PROGRAM = Path(network.__file__).resolve().parents[1]
"""The folder that this program was loaded from, which hosts run too."""


def node_of(organisation: str) -> str:
    return f"{organisation}-1"


class FoundedNetwork:
    """Runs commands on hosts. `visitor` and `stranger`: hosts without a node. `programs`: another program for a host."""

    def __init__(self, hosts: Hosts) -> None:
        self.hosts = hosts.hosts
        self.visitor = self.hosts["visitor"]
        self.programs: dict[str, Path] = {}

    def spawn(
        self, host: Host, module: str, *arguments: str, stderr: int | IO[str] = subprocess.PIPE
    ) -> subprocess.Popen[str]:
        """Start `python -m module` there, with its input and output open to us."""
        return subprocess.Popen(
            [*host.prefix, sys.executable, "-m", module, *arguments],
            cwd=host.home,
            env=self._environment(host),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )

    def _environment(self, host: Host) -> Mapping[str, str]:
        return {
            "HOME": str(host.home),
            "BLOCKROBOT_HOME": str(host.home / "br"),
            "BLOCKROBOT_PASSPHRASE_FILE": str(host.home / "passphrase"),
            "PATH": os.environ["PATH"],
            "PYTHONPATH": str(self.programs.get(host.name, PROGRAM)),
            "LANG": "C.UTF-8",
        }

    def run(self, host: Host, *arguments: str, fails: bool = False) -> str:
        """Type `blockrobot ...` there; return what was written on standard output. Raises HOSTS_STORY_FAILED."""
        with self.spawn(host, "network.cli.main", *arguments) as process:
            try:
                output, said = process.communicate(timeout=COMMAND_MAX_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise _failed(host, arguments, f"it did not end within {COMMAND_MAX_S} s") from None
        if (process.returncode != 0) != fails:
            raise _failed(host, arguments, f"{output}{said}")
        return said if fails else output

    def ask(self, host: Host, *arguments: str) -> dict[str, Any]:
        answer: dict[str, Any] = read_json_as(self.run(host, *arguments, "--json"), dict[str, Any])
        return answer

    def found(
        self,
        *,
        new: Mapping[str, Sequence[str]] | None = None,
        init: Mapping[str, Sequence[str]] | None = None,
        after_init: Callable[[FoundedNetwork, str], None] | None = None,
        before_start: Callable[[FoundedNetwork, str], None] | None = None,
    ) -> None:
        """The ceremony, party by party. `new`, `init`: more words for an organisation's `org new`, `node init`."""
        entries: list[Path] = []
        for name in ORGANISATIONS:
            host = self.hosts[name]
            self.run(host, "org", "new", name, *(new or {}).get(name, ()))
            more = ("--bind", host.address, "--custodian", *(init or {}).get(name, ()))
            self.run(host, "node", "init", node_of(name), "--founding", "--organisation", name, *more)
            if after_init is not None:
                after_init(self, name)
            place = self.folder(name)
            entries += [place / "organisations" / name / "organisation-entry.json"]
            entries += [place / "nodes" / node_of(name) / "node-entry.json"]
        for name in ORGANISATIONS:
            host = self.hosts[name]
            handed = [self._hand_over(path, host, number) for number, path in enumerate(entries)]
            self.run(host, "genesis", "make", *map(str, handed), "--out", str(host.home / "genesis.json"))
            self.run(host, "genesis", "check", str(host.home / "genesis.json"), "--adopt")
            if before_start is not None:
                before_start(self, name)
            self.run(host, "node", "run", node_of(name), "--detach")
        self.wait(self.is_whole, "all nodes are linked")

    def is_whole(self) -> bool:
        return all(len(self.status(name)["peers"]) == len(ORGANISATIONS) - 1 for name in ORGANISATIONS)

    def folder(self, organisation: str) -> Path:
        return self.hosts[organisation].home / "br" / "network"

    def data_dir(self, organisation: str) -> Path:
        return self.folder(organisation) / "nodes" / node_of(organisation)

    def _hand_over(self, path: Path, host: Host, number: int) -> Path:
        copy = host.home / f"entry-{number}.json"
        copy.write_bytes(path.read_bytes())
        return copy

    @property
    def genesis_path(self) -> Path:
        return self.hosts[ORGANISATIONS[0]].home / "genesis.json"

    @property
    def genesis(self) -> Genesis:
        return genesis_from_json(self.genesis_path.read_text(encoding="utf-8"))

    def issue_card(self, uid: str, role: str) -> str:
        """At the hospital's desk."""
        return Registrar(self.folder("hospital") / "organisations" / "hospital", self.genesis).issue(uid, role)

    def status(self, organisation: str) -> dict[str, Any]:
        """What the node of an organisation says of itself, on its host; asked often enough to see what lasts a second."""
        token = self.data_dir(organisation) / "operator-read.token"
        if not token.exists():
            return {"peers": [], "finalized_height": -1}
        done = subprocess.run(
            [*self.hosts[organisation].prefix, sys.executable, "-c", _READ_STATUS],
            input=token.read_text(encoding="ascii"),
            capture_output=True,
            text=True,
            timeout=COMMAND_MAX_S,
            check=False,
        )
        said = read_json_as(done.stdout, dict[str, Any]) if done.returncode == 0 else {}
        return {"peers": [], "finalized_height": -1} | said

    def elsewhere(self, organisation: str, *options: str) -> dict[str, dict[str, Any]]:
        """What `status` there says of the nodes on other hosts."""
        return {row["name"]: row for row in self.ask(self.hosts[organisation], *options, "status")["elsewhere"]}

    def propose(self, organisation: str) -> int:
        """Let an organisation make a proposal and withdraw it; return the height at which that is final."""
        host = self.hosts[organisation]
        said = self.ask(host, "settings", "propose", "heartbeat_ms", "20000")
        return int(self.ask(host, "settings", "withdraw", said["proposal"]["id"])["height"])

    def wait(self, holds: Callable[[], bool], what: str) -> None:
        """Until it is so. Raises HOSTS_STORY_FAILED."""
        deadline_s = time.monotonic() + WAIT_MAX_S
        while not holds():
            if time.monotonic() > deadline_s:
                raise BlockRobotError("HOSTS_STORY_FAILED", f"Within {WAIT_MAX_S} s it did not come about that {what}.")
            time.sleep(POLL_S)


def _failed(host: Host, arguments: Sequence[str], said: str) -> BlockRobotError:
    return BlockRobotError("HOSTS_STORY_FAILED", f"On {host.name}, `blockrobot {' '.join(arguments)}`: {said.strip()}")
