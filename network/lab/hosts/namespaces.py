"""Several hosts on this machine: network namespaces, joined by a bridge, each with an address and a home of its own."""

from __future__ import annotations

import secrets
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from consensus.errors import BlockRobotError

SUBNET = "10.77.0"
COMMAND_MAX_S = 30


class Host:
    """One host: the first words of a command that is to run there, its address and its home."""

    def __init__(self, name: str, namespace: str, address: str, home: Path) -> None:
        self.name = name
        self.namespace = namespace
        self.address = address
        self.home = home

    @property
    def prefix(self) -> list[str]:
        return ["ip", "netns", "exec", self.namespace]

    def renumber(self, address: str) -> None:
        """Give the host another address in place of its own."""
        _run(*self.prefix, "ip", "address", "delete", f"{self.address}/24", "dev", "eth0")
        _run(*self.prefix, "ip", "address", "add", f"{address}/24", "dev", "eth0")
        self.address = address

    def add_address(self, address: str) -> None:
        """Give the host one more address, as a hospital's network has many."""
        _run(*self.prefix, "ip", "address", "add", f"{address}/24", "dev", "eth0")

    def cut(self, *, off: bool) -> None:
        """Take the host's cable out, or put it back."""
        _run(*self.prefix, "ip", "link", "set", "eth0", "down" if off else "up")


class Hosts:
    """A context manager: hosts by name, on one bridge. All that runs on them ends with it."""

    def __init__(self, place: Path, names: Sequence[str]) -> None:
        token = secrets.token_hex(3)
        self._lan = f"brn-{token}-lan"
        self.hosts = {
            name: Host(name, f"brn-{token}-{name}", f"{SUBNET}.{number}", place / name)
            for number, name in enumerate(names, 1)
        }

    def __enter__(self) -> Self:
        """Raises HOSTS_UNAVAILABLE."""
        if shutil.which("ip") is None:
            raise BlockRobotError("HOSTS_UNAVAILABLE", "The program `ip` of iproute2 is not here.")
        try:
            _run("ip", "netns", "add", self._lan)
            _run("ip", "-n", self._lan, "link", "add", "lan", "type", "bridge")
            _run("ip", "-n", self._lan, "link", "set", "lan", "up")
            for number, host in enumerate(self.hosts.values()):
                self._join(host, f"port{number}")
        except BaseException:
            self._end()
            raise
        return self

    def _join(self, host: Host, port: str) -> None:
        host.home.mkdir(parents=True)
        _run("ip", "netns", "add", host.namespace)
        _run(
            "ip", "-n", host.namespace, "link", "add", "eth0", "type", "veth", "peer", "name", port, "netns", self._lan
        )
        _run("ip", "-n", self._lan, "link", "set", port, "master", "lan", "up")
        _run("ip", "-n", host.namespace, "address", "add", f"{host.address}/24", "dev", "eth0")
        for link in ("lo", "eth0"):
            _run("ip", "-n", host.namespace, "link", "set", link, "up")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def _end(self) -> None:
        for name in (*(host.namespace for host in self.hosts.values()), self._lan):
            found = subprocess.run(["ip", "netns", "pids", name], capture_output=True, text=True, check=False)
            for pid in found.stdout.split():
                subprocess.run(["kill", "-9", pid], check=False)
            subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)


def _run(*command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_MAX_S, check=False)
    except subprocess.TimeoutExpired:
        raise BlockRobotError(
            "HOSTS_UNAVAILABLE", f"`{' '.join(command)}` did not end within {COMMAND_MAX_S} s."
        ) from None
    if done.returncode != 0:
        raise BlockRobotError("HOSTS_UNAVAILABLE", f"`{' '.join(command)}` failed: {done.stderr.strip()}")
