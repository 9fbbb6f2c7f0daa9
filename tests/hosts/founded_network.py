"""A network of four organisations, each with a node on a host of its own, founded by commands typed there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.hosts.namespaces import Host, Hosts

ORGANISATIONS = ("clinic", "hospital", "lab", "university")
WITH_ITS_OWN_AUTHORITY = "lab"
"""Its authority's key is on the visitor's host, and OpenSSL signs there."""
COMMAND_MAX_S = 90
WAIT_MAX_S = 60
BIN = Path(sys.executable).parent


def node_of(organisation: str) -> str:
    return f"{organisation}-1"


class FoundedNetwork:
    """Runs commands on hosts. `visitor`: a host without a node."""

    def __init__(self, hosts: Hosts) -> None:
        self.hosts = hosts.hosts
        self.visitor = self.hosts["visitor"]

    def run(self, host: Host, *arguments: str, fails: bool = False) -> str:
        """Type `blockrobot ...` there; return what was written on standard output."""
        environment = {
            "HOME": str(host.home),
            "BLOCKROBOT_HOME": str(host.home / "br"),
            "PATH": f"{BIN}:{os.environ['PATH']}",
            "LANG": "C.UTF-8",
        }
        done = subprocess.run(
            [*host.prefix, "blockrobot", *arguments],
            cwd=host.home,
            env=environment,
            capture_output=True,
            text=True,
            timeout=COMMAND_MAX_S,
            check=False,
        )
        assert (done.returncode != 0) == fails, f"{arguments}: {done.stdout}{done.stderr}"
        return done.stdout if not fails else done.stderr

    def ask(self, host: Host, *arguments: str) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(self.run(host, *arguments, "--json"))
        return answer

    def found(self) -> None:
        """The ceremony, party by party."""
        entries: list[Path] = []
        for name in ORGANISATIONS:
            host = self.hosts[name]
            self.run(host, "org", "new", name, *self._authority_of(name))
            bind = ("--bind", host.address, "--custodian")
            self.run(host, "node", "init", node_of(name), "--founding", "--organisation", name, *bind)
            network = host.home / "br" / "network"
            if name == WITH_ITS_OWN_AUTHORITY:
                self._certify(host, network / "nodes" / node_of(name))
            entries += [network / "organisations" / name / "organisation-entry.json"]
            entries += [network / "nodes" / node_of(name) / "node-entry.json"]
        for name in ORGANISATIONS:
            host = self.hosts[name]
            handed = [self._hand_over(path, host, number) for number, path in enumerate(entries)]
            self.run(host, "genesis", "make", *map(str, handed), "--out", str(host.home / "genesis.json"))
            self.run(host, "genesis", "check", str(host.home / "genesis.json"), "--adopt")
            self.run(host, "node", "run", node_of(name), "--detach")
        self.wait(lambda: all(len(self.status(name)["peers"]) == len(ORGANISATIONS) - 1 for name in ORGANISATIONS))

    def _authority_of(self, name: str) -> tuple[str, ...]:
        if name != WITH_ITS_OWN_AUTHORITY:
            return ()
        made = ("-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "9")
        usage = ("-addext", "keyUsage=critical,keyCertSign,cRLSign")
        self._openssl("req", *made, *usage, "-subj", "/CN=Lab Servers CA", "-keyout", "ca.key", "-out", "ca.pem")
        return ("--certificate", str(self.visitor.home / "ca.pem"))

    def _certify(self, host: Host, data_dir: Path) -> None:
        (self.visitor.home / "node.csr").write_bytes((data_dir / "node.csr").read_bytes())
        by = ("-CA", "ca.pem", "-CAkey", "ca.key", "-copy_extensions", "copy", "-days", "9")
        self._openssl("x509", "-req", "-in", "node.csr", *by, "-out", "node.pem")
        self.run(host, "certificate", "install", data_dir.name, str(self.visitor.home / "node.pem"))

    def _openssl(self, *arguments: str) -> None:
        subprocess.run(
            [*self.visitor.prefix, "openssl", *arguments],
            cwd=self.visitor.home,
            capture_output=True,
            timeout=COMMAND_MAX_S,
            check=True,
        )

    def _hand_over(self, path: Path, host: Host, number: int) -> Path:
        copy = host.home / f"entry-{number}.json"
        copy.write_bytes(path.read_bytes())
        return copy

    def status(self, organisation: str) -> dict[str, Any]:
        """What the node of an organisation says of itself, on its host; asked often enough to see what lasts a second."""
        host = self.hosts[organisation]
        token = host.home / "br" / "network" / "nodes" / node_of(organisation) / "operator-read.token"
        header = f"Authorization: Bearer {token.read_text() if token.exists() else ''}"
        command = [*host.prefix, "curl", "-sf", "-m", "5", "-H", header, "http://127.0.0.1:7274/status"]
        done = subprocess.run(command, capture_output=True, timeout=COMMAND_MAX_S, check=False)
        said: dict[str, Any] = json.loads(done.stdout) if done.returncode == 0 else {}
        return {"peers": [], "finalized_height": -1} | said

    def elsewhere(self, organisation: str, *options: str) -> dict[str, dict[str, Any]]:
        """What `status` there says of the nodes on other hosts."""
        return {row["name"]: row for row in self.ask(self.hosts[organisation], *options, "status")["elsewhere"]}

    def propose(self, organisation: str) -> int:
        """Let an organisation make a proposal and withdraw it; return the height at which that is final."""
        host = self.hosts[organisation]
        said = self.ask(host, "settings", "propose", "heartbeat_ms", "20000")
        return int(self.ask(host, "settings", "withdraw", said["proposal"]["id"])["height"])

    def wait(self, holds: Any) -> None:
        """Until it is so; at most a minute."""
        deadline_s = time.monotonic() + WAIT_MAX_S
        while not holds():
            assert time.monotonic() < deadline_s, "it did not come about"
            time.sleep(0.2)
