"""A local cluster: node processes on loopback, started, watched and stopped.

A folder holds `genesis.json`, `nodes/<name>/` and `organisations/`; `cluster.json` keeps only process ids and Byzantine
starts.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import aiohttp
import msgspec

from clients.sdk.new_files import require_seen
from clients.sdk.terminal.terminal import load_genesis
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.visible_text import split_lines
from node.config import CONFIG_FILE, OPERATOR_HOST, NodeConfig, load_config, reading_headers
from node.faults import STATE_FILE_NAME

READY_TIMEOUT_S = 40.0
STOP_TIMEOUT_S = 15.0
_POLL_S = 0.05
_PF_EXITING = 4  # include/linux/sched.h
_STATE_FILE = "cluster.json"


@dataclass(frozen=True, slots=True)
class NodeStatusReport:
    """One line of `blockrobot status`; None if the node does not answer."""

    name: str
    running: bool
    status: dict[str, Any] | None
    behaviour: str = ""
    """How it was told to lie; empty for an honest node."""


class _ClusterState(msgspec.Struct):
    pids: dict[str, int] = {}
    behaviours: dict[str, str] = {}


def machine_words() -> str:
    """What may make it too slow."""
    return f"the machine has {os.cpu_count()} cores and a load of {os.getloadavg()[0]:.1f}"


def no_network(folder: Path) -> BlockRobotError:
    """What to raise where there is no genesis file. Raises PermissionError if that cannot be seen."""
    require_seen(folder.parent, "genesis.json", folder.name)
    own = [path.parent / "genesis.json" for path in sorted((folder / "nodes").glob(f"*/{CONFIG_FILE}"))]
    known = next((path for path in own if path.is_file()), None)
    if known is not None:
        sentence = f"{folder} has no genesis.json; that of its nodes' network: cp {known} {folder}"
        return BlockRobotError("CLUSTER_NOT_RUNNING", sentence)
    if own:
        return BlockRobotError("NETWORK_NOT_FOUNDED", f"The nodes in {folder} belong to no network yet.")
    return BlockRobotError("CLUSTER_NOT_RUNNING", f"There is no network in {folder}.")


class Cluster:
    """The nodes of one network folder."""

    def __init__(self, folder: Path) -> None:
        """Raises CLUSTER_NOT_RUNNING if the folder has no network."""
        # Whoever named it otherwise before, from another place or by a link, has to find the processes that run.
        self.folder = folder.resolve()
        path = self.folder / "genesis.json"
        if not path.exists():
            raise no_network(folder)
        self.genesis: Genesis = load_genesis(path)
        self.configs: dict[str, NodeConfig] = {
            name: load_config(self.folder / "nodes" / name) for name in self._find_names()
        }
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def names(self) -> list[str]:
        return list(self.configs)

    def _find_names(self) -> list[str]:
        first = [node.name for node in self.genesis.nodes]
        found = {path.parent.name for path in (self.folder / "nodes").glob(f"*/{CONFIG_FILE}")}
        return [name for name in first if name in found] + sorted(found.difference(first))

    def start(self, name: str, *, behaviour: str = "", seed: int = 0, restored: bool = False) -> None:
        """Detached, Byzantine with `behaviour`; `restored` means from a backup."""
        config = self.config(name)
        command = [sys.executable, "-m", "node.main", "--data-dir", str(config.data_dir)]
        if behaviour:
            command[2] = "network.byzantine.process"
            command += ["--behaviour", behaviour, "--seed", str(seed)]
        elif restored:
            command.append("--restored")
        output = (config.data_dir / "output.log").open("ab")
        with output:
            child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._children[name] = child
        self._note_start(name, child.pid, behaviour)

    def config(self, name: str) -> NodeConfig:
        """Raises NOT_FOUND, PermissionError."""
        if name not in self.configs:
            require_seen(self.folder / "nodes", CONFIG_FILE, name)
            raise BlockRobotError(
                "NOT_FOUND", f"There is no node {name!r}; there are {', '.join(self.names) or 'none'}."
            )
        return self.configs[name]

    def start_all(self) -> list[str]:
        """Start those that are down; return their names. A network of which none runs starts without faults.

        Raises CLUSTER_ALREADY_RUNNING.
        """
        down = [name for name in self.names if not self.is_running(name)]
        if not down:
            raise BlockRobotError("CLUSTER_ALREADY_RUNNING", f"Already running: {', '.join(self.names)}.")
        for name in down:
            if down == self.names:
                (self.config(name).data_dir / STATE_FILE_NAME).unlink(missing_ok=True)
            self.start(name)
        return down

    def kill(self, name: str) -> None:
        self._signal(name, signal.SIGKILL)
        self._reap(name, STOP_TIMEOUT_S)

    def pause(self, name: str) -> None:
        """By SIGSTOP: connections stay open."""
        self._signal(name, signal.SIGSTOP)

    def resume(self, name: str) -> None:
        self._signal(name, signal.SIGCONT)

    def is_paused(self, name: str) -> bool:
        pid = self._read_state().pids.get(name)
        return pid is not None and self.is_running(name) and _is_stopped_process(pid)

    def behaviour(self, name: str) -> str:
        """Byzantine; empty if honest."""
        return self._read_state().behaviours.get(name, "") if self.is_running(name) else ""

    def stop(self, name: str) -> None:
        """Cleanly, or forcibly after fifteen seconds."""
        self._signal(name, signal.SIGTERM)
        self._signal(name, signal.SIGCONT)
        if not self._reap(name, STOP_TIMEOUT_S):
            self.kill(name)

    def stop_all(self, names: Sequence[str] = ()) -> list[str]:
        """Or only these. Cleanly; return the names of those that ran. Raises NOT_FOUND."""
        chosen = [self.config(name).data_dir.name for name in dict.fromkeys(names)] or self.names
        running = [name for name in chosen if self.is_running(name)]
        for name in running:
            self._signal(name, signal.SIGTERM)
            self._signal(name, signal.SIGCONT)
        for name in running:
            if not self._reap(name, STOP_TIMEOUT_S):
                self.kill(name)
        if not names:
            (self.folder / _STATE_FILE).unlink(missing_ok=True)
        for child in self._children.values():
            child.poll()  # one that somebody else killed and replaced is still this process's child
        return running

    def is_running(self, name: str) -> bool:
        pid = self._read_state().pids.get(name)
        child = self._children.get(name)
        if child is not None and child.pid == pid:
            return child.poll() is None
        return pid is not None and _is_node_process(pid, self.config(name).data_dir)

    def _signal(self, name: str, number: signal.Signals) -> None:
        pid = self._read_state().pids.get(name)
        if pid is not None and self.is_running(name):
            with contextlib.suppress(ProcessLookupError):  # it ended by itself just now
                os.kill(pid, number)

    def _reap(self, name: str, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while self.is_running(name):
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL_S)
        return True

    def _read_state(self) -> _ClusterState:
        try:
            return read_json_as((self.folder / _STATE_FILE).read_bytes(), _ClusterState)
        except (FileNotFoundError, TextInvalidError):
            return _ClusterState()

    def _note_start(self, name: str, pid: int, behaviour: str) -> None:
        state = self._read_state()
        state.pids[name] = pid
        state.behaviours.pop(name, None)
        if behaviour:
            state.behaviours[name] = behaviour
        path = self.folder / _STATE_FILE
        temporary = path.with_suffix(".tmp")
        temporary.write_bytes(msgspec.json.encode(state))
        temporary.replace(path)

    async def wait_ready(self, names: list[str] | None = None, timeout_s: float = READY_TIMEOUT_S) -> None:
        """Default all. Raises CLUSTER_START_FAILED; its context lists space-separated `nodes`. Nodes that report they
        cannot participate are skipped unless named.
        """
        deadline = time.monotonic() + timeout_s
        waiting = list(names or self.names)
        async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=1)) as session:
            while waiting:
                for name in list(waiting):
                    if not self.is_running(name):
                        detail = f"Node {name} stopped: {self.latest_messages(name)}"
                        raise BlockRobotError("CLUSTER_START_FAILED", detail, nodes=name)
                    if await self._answers_ready(session, name, is_asked_for=names is not None):
                        waiting.remove(name)
                if waiting and time.monotonic() > deadline:
                    detail = f"Not ready in time: {', '.join(waiting)}; {machine_words()}."
                    raise BlockRobotError("CLUSTER_START_FAILED", detail, nodes=" ".join(waiting))
                if waiting:
                    await asyncio.sleep(_POLL_S)

    async def wait_answering(self, name: str, timeout_s: float = READY_TIMEOUT_S) -> None:
        """Ready or not. Raises CLUSTER_START_FAILED, NODE_STILL_STARTING."""
        deadline = time.monotonic() + timeout_s
        async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=1)) as session:
            while not self._is_own(name, await fetch_status(session, self.configs[name])):
                if not self.is_running(name):
                    raise BlockRobotError("CLUSTER_START_FAILED", f"Node {name} stopped: {self.latest_messages(name)}")
                if time.monotonic() > deadline:
                    detail = f"{name} has not answered in {timeout_s:.0f} s, and its process goes on."
                    raise BlockRobotError("NODE_STILL_STARTING", detail)
                await asyncio.sleep(_POLL_S)

    async def _answers_ready(self, session: aiohttp.ClientSession, name: str, *, is_asked_for: bool) -> bool:
        status = await fetch_status(session, self.configs[name])
        if status is None or not self._is_own(name, status):
            return False
        is_left_out = status.get("membership", "active") != "active" or bool(status.get("problem"))
        return bool(status.get("ready")) or (is_left_out and not is_asked_for)

    def _is_own(self, name: str, status: dict[str, Any] | None) -> bool:
        chain_id = self.genesis.chain_id.hex()
        return status is not None and (status.get("name"), status.get("chain_id")) == (name, chain_id)

    def latest_messages(self, name: str) -> str:
        path = self.config(name).data_dir / "output.log"
        lines = split_lines(path.read_text(encoding="utf-8", errors="replace").strip()) if path.exists() else []
        return lines[-1] if lines else "it printed nothing."

    def last_lines(self, name: str, count: int) -> list[str]:
        config, lines = self.config(name), []
        for path in (config.log_path, config.data_dir / "output.log"):
            if path.exists():
                lines += split_lines(path.read_text(encoding="utf-8", errors="replace"))[-count:]
        return lines

    async def status(self, timeout_s: float = 2.0) -> list[NodeStatusReport]:
        async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=timeout_s)) as session:
            answers = await asyncio.gather(*(fetch_status(session, config) for config in self.configs.values()))
        owned = [
            (name, answer if self._is_own(name, answer) else None)
            for name, answer in zip(self.names, answers, strict=True)
        ]
        return [
            NodeStatusReport(
                name=name,
                running=answer is not None or self.is_running(name),  # a unit of systemd leaves no process id here
                status=answer,
                behaviour=self.behaviour(name),
            )
            for name, answer in owned
        ]


async def read_metric(config: NodeConfig, name: str, label: str = "") -> float | None:
    """The sum of a Prometheus metric over its series with this label (`name="value"`); None without any."""
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=2)) as session:
        try:
            async with session.get(_operator_url(config, "/metrics"), headers=reading_headers(config)) as response:
                lines = split_lines(await response.text())
        except (aiohttp.ClientError, TimeoutError):
            return None
    series = [line.rsplit(" ", 1) for line in lines if line.startswith((f"{name} ", f"{name}{{"))]
    values = [float(value) for labels, value in series if label in labels]
    return sum(values) if values else None


def _operator_url(config: NodeConfig, path: str) -> str:
    return f"http://{OPERATOR_HOST}:{config.operator_port}{path}"


async def fetch_status(session: aiohttp.ClientSession, config: NodeConfig) -> dict[str, Any] | None:
    """None without a valid answer."""
    try:
        async with session.get(_operator_url(config, "/status"), headers=reading_headers(config)) as response:
            return read_json_as(await response.read(), dict[str, Any])
    except (aiohttp.ClientError, TimeoutError, TextInvalidError):
        return None


def _is_node_process(pid: int, data_dir: Path) -> bool:
    """A pid may have been reused by another process."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return False
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return True  # no /proc here (macOS): the number is all there is to go by
    return str(data_dir).encode() in command.split(b"\0") if command else _is_exiting_process(pid)


def _is_exiting_process(pid: int) -> bool:
    """A killed process without memory may still hold file locks."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    except OSError:
        return False
    state, flags = fields[0], int(fields[6])
    return state not in "ZX" and bool(flags & _PF_EXITING)


def _is_stopped_process(pid: int) -> bool:
    """State T."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2]
    except OSError:  # no /proc here (macOS)
        answer = subprocess.run(["ps", "-o", "state=", "-p", str(pid)], capture_output=True, text=True, check=False)
        state = answer.stdout
    return state.strip().startswith("T")
