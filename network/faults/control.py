"""Applies fault actions to a local cluster.

A running node is reached over its operator listener, with its data directory's token; a stopped one by a file that it
reads at start, so a partition also holds for it.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import aiohttp
import msgspec

from consensus.bounded_text import read_json_as
from consensus.errors import CATALOGUE, BlockRobotError
from network.cluster import Cluster
from network.faults.actions import (
    Action,
    ActionReader,
    FillDisk,
    GoByzantine,
    Heal,
    Kill,
    Partition,
    Pause,
    Restart,
    Resume,
    SetLink,
    Skew,
    format_duration,
)
from node.api_adapters import WallClock
from node.config import OPERATOR_HOST
from node.faults import TOKEN_FILE_NAME, FaultRequest, FaultSwitch
from node.p2p.link_faults import SOUND, LinkFault

REQUEST_TIMEOUT_S = 2.0
STARTING_TIMEOUT_S = 20.0
"""A node that was started a moment ago is waited for: it hears as soon as it serves."""
_POLL_S = 0.1


@dataclass(frozen=True, slots=True)
class NodeFaults:
    """A node's injected faults. `switched`: its own switch's state, None if not reported."""

    name: str
    running: bool
    paused: bool
    behaviour: str
    switched: Mapping[str, Any] | None

    def describe(self) -> list[str]:
        words = [] if self.running else ["down"]
        words += ["paused"] if self.paused else []
        words += [f"byzantine: {self.behaviour}"] if self.behaviour else []
        if self.switched is None:
            return words
        for peer, fault in self.switched["links"].items():
            words.append(f"-> {peer}: {msgspec.convert(fault, LinkFault).describe()}")
        if self.switched["clock_offset_ms"]:
            words.append(f"clock {format_duration(self.switched['clock_offset_ms'])}")
        return words + [f"{disk} disk full" for disk in self.switched["disk"]]


class FaultControl:
    """The faults of one cluster."""

    def __init__(self, cluster: Cluster, seed: int = 0) -> None:
        """`seed`, with a link's ends, seeds that link's random losses."""
        self.cluster = cluster
        self.reader = ActionReader(tuple(cluster.names))
        self._seed = seed

    async def carry_out(self, action: Action) -> None:
        """Raises FAULT_UNKNOWN, FAULTS_DISABLED, FAULT_TARGET_ABSENT, CLUSTER_START_FAILED."""
        self._require_allowed(action.touched() or self._allowing())
        match action:
            case Kill(node=node):
                await asyncio.to_thread(self._running(node).kill, node)
            case Pause(node=node):
                self._running(node).pause(node)
            case Resume(node=node):
                self._running(node).resume(node)
            case Restart(node=node):
                await self._restart(node, "", 0)
            case GoByzantine(node=node, behaviour=behaviour, seed=seed):
                await self._restart(node, behaviour, seed)
            case Partition(groups=groups):
                await self._partition(groups)
            case SetLink():
                await self._set_link(action)
            case Skew(node=node, offset_ms=offset_ms):
                await self._tell(node, FaultRequest(clock_offset_ms=offset_ms))
            case FillDisk(node=node, disk=disk, is_full=is_full):
                await self._tell(node, FaultRequest(disk={disk: is_full}))
            case Heal(nodes=nodes):
                await self._heal(nodes)

    async def state(self) -> list[NodeFaults]:
        return list(await asyncio.gather(*(self._state_of(name) for name in self.cluster.names)))

    async def _state_of(self, name: str) -> NodeFaults:
        cluster = self.cluster
        try:
            switched = await self._switched(name)
        except BlockRobotError:
            switched = None
        is_paused, behaviour = cluster.is_paused(name), cluster.behaviour(name)
        return NodeFaults(name, cluster.is_running(name), is_paused, behaviour, switched)

    def require_running(self, name: str) -> None:
        """Raise FAULT_TARGET_ABSENT."""
        self._running(name)

    def _running(self, name: str) -> Cluster:
        if not self.cluster.is_running(self.reader.node(name)):
            raise BlockRobotError("FAULT_TARGET_ABSENT", f"{name} is not running.")
        return self.cluster

    def _allowing(self) -> tuple[str, ...]:
        """Raises FAULTS_DISABLED."""
        found = tuple(name for name in self.cluster.names if self.cluster.config(name).faults_enabled)
        if not found:
            raise BlockRobotError("FAULTS_DISABLED", "No node of this network takes faults.")
        return found

    def _require_allowed(self, names: Iterable[str]) -> None:
        """Raise FAULTS_DISABLED, before anything is done."""
        for name in names:
            if not self.cluster.config(self.reader.node(name)).faults_enabled:
                raise BlockRobotError("FAULTS_DISABLED", f"{name} takes no faults: its node.toml does not allow them.")

    def _require_listening(self, names: Iterable[str]) -> None:
        for name in names:
            if self.cluster.is_paused(name):
                raise BlockRobotError("FAULT_TARGET_ABSENT", f"{name} is paused.")

    async def _restart(self, name: str, behaviour: str, seed: int) -> None:
        self.reader.node(name)
        if self.cluster.is_running(name):
            await asyncio.to_thread(self.cluster.stop, name)
        self.cluster.start(name, behaviour=behaviour, seed=seed)

    async def _heal(self, nodes: tuple[str, ...]) -> None:
        allowing = self._allowing()
        chosen = nodes or allowing
        for name in chosen:
            if self.cluster.is_paused(name):
                self.cluster.resume(name)
        self._require_listening(allowing)
        await asyncio.gather(*(self._tell(name, FaultRequest(clear=True)) for name in chosen))
        if nodes:
            others = [name for name in allowing if name not in nodes]
            sound: dict[str, LinkFault | None] = dict.fromkeys(nodes)
            await asyncio.gather(*(self._tell(name, FaultRequest(links=sound)) for name in others))
        for name in chosen:
            if self.cluster.behaviour(name):
                await self._restart(name, "", 0)

    async def _partition(self, groups: tuple[tuple[str, ...], ...]) -> None:
        group_of = {self.reader.node(name): number for number, group in enumerate(groups) for name in group}
        self._require_listening(group_of)
        asked = await asyncio.gather(*(self._ask_patiently(name, "GET", b"") for name in group_of))
        states = {
            name: self._switch_of(name).describe() if answer is None else answer
            for name, answer in zip(group_of, asked, strict=True)
        }
        wanted = {}
        for name, state in states.items():
            links: dict[str, LinkFault | None] = {}
            for peer, number in group_of.items():
                known = msgspec.convert(state["links"].get(peer, {}), LinkFault)
                is_cut = number != group_of[name]
                if peer != name and known.cut != is_cut:
                    links[peer] = msgspec.structs.replace(known, cut=is_cut)
            wanted[name] = FaultRequest(links=links)
        await asyncio.gather(*(self._tell(name, request) for name, request in wanted.items()))

    async def _set_link(self, action: SetLink) -> None:
        self._require_listening([action.source, action.target])
        fault = None if action.fault == SOUND else action.fault
        await self._tell(action.source, FaultRequest(links={action.target: fault}, seed=self._seed))
        if action.is_both:
            await self._tell(action.target, FaultRequest(links={action.source: fault}, seed=self._seed))

    # Talking to one node

    async def _switched(self, name: str) -> Mapping[str, Any]:
        """Raises FAULTS_DISABLED and FAULT_TARGET_ABSENT."""
        self._require_allowed([name])
        if not self.cluster.is_running(name) or self.cluster.is_paused(name):
            return self._switch_of(name).describe()
        return await self._ask(name, "GET", b"")

    async def _tell(self, name: str, request: FaultRequest) -> None:
        self._require_allowed([name])
        body = msgspec.json.encode(request)
        if await self._ask_patiently(name, "POST", body) is None:
            self._switch_of(name).request(body)

    async def _ask_patiently(self, name: str, method: str, body: bytes) -> Mapping[str, Any] | None:
        deadline_s = time.monotonic() + STARTING_TIMEOUT_S
        while self.cluster.is_running(name):
            try:
                return await self._ask(name, method, body)
            except BlockRobotError as error:
                is_starting = error.code == "FAULT_TARGET_ABSENT" and not self.cluster.is_paused(name)
                if not is_starting or time.monotonic() > deadline_s:
                    raise
            await asyncio.sleep(_POLL_S)
        return None

    def _switch_of(self, name: str) -> FaultSwitch:
        return FaultSwitch(name, self.cluster.config(name).data_dir, WallClock())

    async def _ask(self, name: str, method: str, body: bytes) -> Mapping[str, Any]:
        config = self.cluster.config(name)
        url = f"http://{OPERATOR_HOST}:{config.operator_port}/faults"
        try:
            token = (config.data_dir / TOKEN_FILE_NAME).read_text(encoding="ascii").strip()
            headers = {"Authorization": f"Bearer {token}"}
            async with (
                aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=REQUEST_TIMEOUT_S)) as session,
                session.request(method, url, data=body, headers=headers) as response,
            ):
                answer = read_json_as(await response.read(), dict[str, Any])
        except (OSError, aiohttp.ClientError, TimeoutError):
            raise BlockRobotError("FAULT_TARGET_ABSENT", f"{name} does not answer; it may still be starting.") from None
        except ValueError:
            raise BlockRobotError("INTERNAL", f"{name} answers in another form; compare versions.") from None
        if response.status == 200:
            return answer
        code = str(answer.get("code", ""))
        raise BlockRobotError(code if code in CATALOGUE else "INTERNAL", f"{name}: {answer.get('detail', 'refused')}")
