"""A story of a broken network: clients that work all the while, faults, and at the end the clients' own books.

What is checked comes from what the clients were told and read, proved from the genesis file alone (`client_history.py`):
every record that was acknowledged is there, once, on every node; nothing else is; all nodes have the same state. How long
nothing became final is measured by when clients were told, and reported as a property of the test.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from clients.registrar.registrar import Registrar
from clients.sdk.chain.enrolment import NewMember, register_member
from clients.sdk.chain.governance import read_producers
from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.members.vouchers import decode_card_code
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import derive_record_id
from consensus.records.owner_keys import open_visit_keys
from network.bench.finality_probe import longest_gap_s
from network.faults.actions import Action
from network.faults.control import FaultControl
from tests.cluster.client_history import Acknowledged, ClientHistory, Read, Seen
from tests.cluster.network_under_test import NetworkUnderTest

WORK_TIMEOUT_S = 60.0
SAME_TIMEOUT_S = 60.0
_POLL_S = 0.1
_IN_FLIGHT_S = 1.5
"""Longer than what was said before a link was cut is on its way, on a busy machine."""
_PROOF_KEYS_COUNT = 100
_WRITES_A_READ_COUNT = 5
_PAUSE_S = 0.02
"""Between two records of a client: enough load to notice everything, and the machine is left to the nodes."""
_RECORD = b"records\x00record/"
_COUNT = b"audit\x00count/"

Report = Callable[[str, object], None]


def _new_key() -> PrivateKey:
    return PrivateKey(secrets.token_bytes(32))


@dataclass
class Client:
    """A robot with a visit of its own, who prefers one node and asks the others when that one does not help.

    It writes one record after another, and now and then reads what it and the others have written lately.
    """

    name: str
    label: str
    network: NetworkUnderTest
    history: ClientHistory
    key: PrivateKey = field(default_factory=_new_key)
    owner: bytes = b""
    bucket_ms: int = 0
    read_pin: bytes = b""
    read_height: int = 0
    refused: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.client = NetworkClient(self.network.genesis, first=self.name)

    async def enrol(self) -> None:
        """Register with a new card and open a visit."""
        genesis = self.network.genesis
        desk = Registrar(self.network.folder / "organisations" / genesis.organisations[0].name, genesis)
        card = decode_card_code(desk.issue(f"robot-{secrets.token_hex(4)}", "robot"))
        spend, view = _new_key(), _new_key()
        member = NewMember(self.key, spend.public_key, view.public_key, secrets.token_bytes(32))
        await register_member(self.client, card, member, [])
        visit = open_visit_keys(
            secrets.token_bytes(32),
            view.public_key,
            spend.public_key,
            chain_id=genesis.chain_id,
            robot=self.key.public_key,
        )
        now_ms = time.time_ns() // 1_000_000
        self.owner, self.bucket_ms = visit.owner, now_ms - now_ms % TIME_BUCKET_MS
        opening = [visit.owner, visit.ephemeral, visit.view_tag, self.bucket_ms, "demo"]
        await self.client.call(self.key, "records", "open_visit", opening)

    async def record(self) -> None:
        """Submit one record, again and again until it is final, and write it into the book."""
        roots, asked_s = [secrets.token_bytes(32), secrets.token_bytes(32)], time.monotonic()
        record_id = derive_record_id(self.owner, roots[0])
        arguments = [record_id, self.owner, *roots, secrets.token_bytes(SEALED_METADATA_BYTES), self.bucket_ms]
        transaction = self.client.transactions.build(
            self.key, "records", "record", [*arguments, self.bucket_ms + RETENTION_DEFAULT_MS]
        )
        try:
            receipt = await self.client.submit_and_wait(transaction, round(WORK_TIMEOUT_S * 1000))
        except BlockRobotError as error:
            if error.code in {"TRANSACTION_NOT_FINAL_IN_TIME", "CALL_REFUSED"}:
                raise
            self.refused.append(error.code)
            self.history.given_up.add(record_id)
            await asyncio.sleep(_POLL_S)
            return
        assert receipt.ok, receipt
        self.history.writes.append(
            Acknowledged(
                client=self.label,
                record_id=record_id,
                txid=receipt.txid,
                height=receipt.height,
                index=receipt.index,
                block_id=receipt.block_id,
                asked_s=asked_s,
                told_s=time.monotonic(),
            )
        )

    async def look_up(self, owners: Mapping[str, bytes], record_ids: Sequence[bytes]) -> None:
        """Read, from whichever node answers, how many records visits have and what became of some records."""
        try:
            await self.read(self.client, self.name, owners, record_ids)
        except BlockRobotError as error:
            if not error.entry.retryable:
                raise
            self.refused.append(error.code)

    async def read(
        self, reader: NetworkClient, node: str, owners: Mapping[str, bytes], record_ids: Sequence[bytes]
    ) -> None:
        """Read from one state, and write down what it says. `owners` are visits by their clients' labels."""
        asked_s = time.monotonic()
        keys = [_COUNT + owner for owner in owners.values()] + [_RECORD + record_id for record_id in record_ids]
        state = await reader.state_values(keys, self.key)
        found = {record_id: state.values[_RECORD + record_id] for record_id in record_ids}
        self.history.reads.append(
            Read(
                client=self.label,
                node=node,
                height=state.height,
                timestamp_ms=state.timestamp_ms,
                asked_s=asked_s,
                told_s=time.monotonic(),
                # The first entry of a visit's audit is that it was opened.
                counts={label: (state.values[_COUNT + owner] or 1) - 1 for label, owner in owners.items()},
                records={
                    key: None if value is None else Seen(value["height"], value["txid"]) for key, value in found.items()
                },
            )
        )

    async def read_all_from(self, node: str, owners: Mapping[str, bytes]) -> None:
        """Read from one node alone, which may show nothing older than this client knows, all that it has written."""
        await self.client.find_nodes(self.key)
        genesis, url = self.network.genesis, self.network.url(node)
        own = [write.record_id for write in self.history.writes if write.client == self.label]
        if self.client.light_client.header.height >= self.read_height:
            self.read_pin = self.client.pinned
        async with NetworkClient(genesis, {node: url}, pinned=self.read_pin) as reader:
            for start in range(0, max(1, len(own)), _PROOF_KEYS_COUNT):
                await self.read(reader, node, owners, own[start : start + _PROOF_KEYS_COUNT])
            # What one node has shown no other may be behind: empty blocks become final at different moments.
            self.read_pin, self.read_height = reader.pinned, reader.light_client.header.height


class Story:
    """A running network, clients at work, and the switch to break it with. Made by the fixture `story`."""

    def __init__(self, network: NetworkUnderTest, report: Report) -> None:
        self.network = network
        self.cluster = network.cluster
        self.names = network.names
        self.control = FaultControl(network.cluster)
        self.clients: list[Client] = []
        self.history = ClientHistory()
        self.report = report
        self._stop = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []

    # Clients

    async def work(self, *names: str) -> None:
        """Let one client at each of these nodes (at every node, if none is named) work from now on."""
        first = len(self.clients)
        fresh = [
            Client(name, f"client-{first + place}", self.network, self.history)
            for place, name in enumerate(names or self.names)
        ]
        await asyncio.gather(*(client.enrol() for client in fresh))
        self.clients += fresh
        self._tasks += [asyncio.create_task(self._keep_working(client)) for client in fresh]

    async def _keep_working(self, client: Client) -> None:
        while not self._stop.is_set():
            await client.record()
            await asyncio.sleep(_PAUSE_S)
            if len(self.history.writes) % _WRITES_A_READ_COUNT == 0:
                newest = [write.record_id for write in self.history.writes[-_WRITES_A_READ_COUNT:]]
                await client.look_up(self._owners, newest)

    @property
    def _owners(self) -> dict[str, bytes]:
        return {client.label: client.owner for client in self.clients}

    async def until_told(self, more: int = 5, timeout_s: float = WORK_TIMEOUT_S) -> None:
        """Wait until clients were told of so many more final records than up to now."""
        goal, deadline_s = self.told_count + more, time.monotonic() + timeout_s
        while self.told_count < goal:
            self._raise_what_failed()
            assert time.monotonic() < deadline_s, f"nothing more was final in {timeout_s} s"
            await asyncio.sleep(_POLL_S / 4)

    @property
    def told_count(self) -> int:
        """How many records clients were told are final."""
        return len(self.history.writes)

    def _raise_what_failed(self) -> None:
        for task in self._tasks:
            if task.done() and not task.cancelled():
                task.result()

    async def rest(self) -> None:
        """Let every client finish what it has begun, and stop."""
        self._stop.set()
        await asyncio.gather(*self._tasks)
        self._tasks.clear()
        self._stop = asyncio.Event()

    async def close(self) -> None:
        """End whatever still runs, of clients and of faults."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for client in self.clients:
            await client.client.close()

    # Faults

    async def do(self, *actions: Action) -> float:
        """Break or mend something; return when it was done (s)."""
        for action in actions:
            await self.control.carry_out(action)
        return time.monotonic()

    async def power_cut(self) -> float:
        """Kill every node at once; return when they were all dead (s)."""
        await asyncio.gather(*(asyncio.to_thread(self.cluster.kill, name) for name in self.names))
        return time.monotonic()

    async def leader(self) -> str:
        """The node that leads now, as most nodes say."""
        said = [str(row.status["leader"]) for row in await self.cluster.status() if row.status is not None]
        return max(set(said), key=said.count)

    async def status(self, name: str) -> dict[str, Any]:
        """What one node says of itself; nothing if it is down or paused."""
        return await self.network.status(name)

    async def wait_until(
        self, name: str, is_so: Callable[[dict[str, Any]], bool], timeout_s: float = WORK_TIMEOUT_S
    ) -> dict[str, Any]:
        """Wait until a node says something of itself; return all that it says then."""
        deadline_s = time.monotonic() + timeout_s
        while not is_so(said := await self.status(name)):
            assert time.monotonic() < deadline_s, f"{name} says {said}"
            await asyncio.sleep(_POLL_S)
        return said

    async def until_still(self, *names: str) -> dict[str, int]:
        """Wait until nothing that was on its way becomes final at these nodes any more; return their heights."""
        deadline_s, before = time.monotonic() + WORK_TIMEOUT_S, None
        while (now := await self._heights(names)) != before:
            assert time.monotonic() < deadline_s, f"blocks go on becoming final: {now}"
            before = now
            await asyncio.sleep(_IN_FLIGHT_S)
        return now

    async def _heights(self, names: Sequence[str]) -> dict[str, int]:
        return {name: (await self.status(name))["finalized_height"] for name in names}

    # Figures

    def gap(self, from_s: float, until_s: float | None = None) -> float:
        """Return the longest time between two records becoming final for a client (s)."""
        told_s = [write.told_s for write in self.history.writes]
        return longest_gap_s(told_s, from_s, time.monotonic() if until_s is None else until_s)

    def report_gap(self, what: str, from_s: float, until_s: float | None = None) -> float:
        """Report, and return, the longest time without finality (s)."""
        gap_s = self.gap(from_s, until_s)
        self.report(f"without_finality_{what}_s", round(gap_s, 3))
        return gap_s

    # The end

    async def end(self, *, without: Sequence[str] = (), liars: Collection[str] = ()) -> None:
        """Let clients finish; check the same state everywhere, and the clients' history with all that every node has.

        `without` names nodes whose word counts for nothing: those that are down for good, or lie. `liars` may have been
        accused of saying two things in one round; of all others nobody may hold such evidence.
        """
        await self.rest()
        honest = [name for name in self.names if name not in without]
        await self.same_state(honest)
        for client in self.clients:
            for name in honest:
                await client.read_all_from(name, self._owners)
        self.report("acknowledged_count", self.told_count)
        self.report("reads_count", len(self.history.reads))
        for found in (self.history.violations(), self.history.unread(honest)):
            assert not found, "\n".join(found)
        assert await self.accused() <= set(liars)

    async def accused(self) -> set[str]:
        """The nodes against whose producer keys the proved state holds evidence."""
        client = self.clients[0]
        view = await read_producers(client.client, client.key)
        return {row.name for row in view.candidates if row.evidence}

    async def same_state(self, names: Sequence[str]) -> str:
        """Wait until these nodes are at one height with one state root, at least as far as clients know; return it."""
        known = max((write.height for write in self.history.writes), default=0)
        deadline_s = time.monotonic() + SAME_TIMEOUT_S
        while True:
            said = [row.status or {} for row in await self.cluster.status() if row.name in names]
            heights = {status.get("finalized_height", -1) for status in said}
            roots = {status.get("state_root") for status in said}
            if len(heights) == 1 and max(heights) >= known:
                assert len(roots) == 1, f"at height {heights} the nodes have different states: {roots}"
                return str(roots.pop())
            assert time.monotonic() < deadline_s, f"the nodes stay at different heights: {heights}, known: {known}"
            await asyncio.sleep(_POLL_S)
