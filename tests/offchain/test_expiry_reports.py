"""A record that expired is called erased in the end, whichever custodian went, came or never had it.

The contracts and the custodians are the real ones: what each owes the chain is submitted, and nothing is said by hand.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from consensus.chain.block import Block, Header, QuorumCertificate, Receipt, Receipts
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.primitives.encoding import encode
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import ciphertext_root, commitment_root
from contracts.execution.executor import execute_block
from node.custody.coordination.custody_coordinator import OUTBOX_LIFETIME_MS, CustodyCoordinator
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys
from node.custody.stores.sqlite_store import SqliteStore
from node.ledger.ledger_writer import FinalityFeed
from node.mempool.transaction_pool import SubmitResult
from node.storage.ledger_store import FinalizedBlock
from node.storage.memory_store import MemoryStore
from tests.offchain.small_chain import RecordedClip, record_clip
from tests.unit.contracts.privacy.hospital import Hospital, key_of

NAMES = ("custodian-1", "custodian-2", "custodian-3")
ROUNDS_MAX_COUNT = 12


def _block(height: int, time_ms: int) -> Block:
    zero = bytes(32)
    qc = QuorumCertificate(epoch=0, round=0, block_id=zero, votes=())
    header = Header(1, zero, 0, height, height, zero, qc, None, 0, time_ms, zero, zero, zero, None, 0)
    return Block(header_bytes=encode(header), signature=b"", transactions=())


class Ward(Hospital):
    """A hospital whose blocks go into a ledger, from which custodians follow them and to which they submit."""

    custodian_names = NAMES

    def __init__(self, directory: Path, opened: AsyncExitStack) -> None:
        self.ledger, self.wires = MemoryStore(), list[bytes]()
        self.directory, self.opened = directory, opened
        self.custodies: dict[str, CustodyCoordinator] = {}
        self._waiting: list[FinalizedBlock] = []
        super().__init__()

    def block(self, transactions: list[Transaction]) -> list[Receipt]:
        if self.height == 0:
            self._keep(dict(self.state.scan(b"", 1 << 60)), ())
        self.height += 1
        self.time_ms += 100
        result = execute_block(self.state, self.contracts, self.context(), transactions)
        self.state.absorb(result.writes, result.page_writes, result.state_root)
        self._keep(result.writes, result.receipts)
        return list(result.receipts)

    def _keep(self, writes: Any, receipts: Sequence[Receipt]) -> None:
        block, told = _block(self.height, self.time_ms), encode(Receipts(tuple(receipts)))
        self._waiting.append(
            FinalizedBlock(
                self.height, block.block_id, encode(block), told, self.time_ms, bytes(32), state_writes=writes
            )
        )

    async def submit(self, wires: Sequence[bytes]) -> list[SubmitResult]:
        self.wires += wires
        return [SubmitResult(decode_transaction(wire).txid, None) for wire in wires]

    async def open_custody(self, name: str) -> None:
        """Begin to follow the chain, with a store that is empty: from the newest state, as who joins by a snapshot."""
        keys = self.opened.enter_context(EraseKeys(self.directory / name))
        store = await self.opened.enter_async_context(SqliteStore(self.directory / f"{name}-store"))
        key = key_of(name)
        custodian = Custodian(store, keys, member=key.public_key, clock_ms=lambda: self.time_ms)
        await custodian.start()
        self.custodies[name] = CustodyCoordinator(
            genesis=self.genesis,
            name=name,
            custodian=custodian,
            key=key,
            ledger=self.ledger,
            feed=FinalityFeed(-1),
            pool=self,  # type: ignore[arg-type]
            peers=SimpleNamespace(connected=[]),  # type: ignore[arg-type]
            clock=lambda: self.time_ms,
        )
        await self.follow()

    async def follow(self) -> None:
        """Let every custodian follow the chain as far as it goes."""
        if self._waiting:
            await self.ledger.commit(self._waiting, b"")
            self._waiting = []
        for custody in self.custodies.values():
            height = custody.checkpoint_height
            while (height := 0 if height is None else height + 1) <= self.height:
                await custody._apply_blocks(height)

    async def settle(self, *silent: str) -> None:
        """Let every custodian but the silent ones say what it owes, until nobody owes anything."""
        for _ in range(ROUNDS_MAX_COUNT):
            await self.follow()
            for name, custody in self.custodies.items():
                if name not in silent:
                    await custody._submit_due()
            wires, self.wires = self.wires, []
            if not wires:
                return
            self.block([decode_transaction(wire) for wire in wires])
            self.time_ms += OUTBOX_LIFETIME_MS
        raise AssertionError("the custodians never stop submitting")

    async def record_of(self, *holders: str) -> RecordedClip:
        """A record of a visit whose clip only some custodians got."""
        visit = self.open_visit(self.enrol("anna"))
        clip = record_clip(valid_until_ms=self.time_ms + 60_000, owner=visit.owner)
        for name in holders:
            await self.custodies[name].custodian.stage(clip.upload)
        roots = (commitment_root(clip.upload.commitment_leaves), ciphertext_root(clip.leaves))
        changes = dict(zip(("record_id", "commitment_root", "ciphertext_root"), (clip.record_id, *roots), strict=True))
        self.record(visit, **changes)
        await self.follow()
        return clip

    def pass_time(self, clip: RecordedClip) -> None:
        self.time_ms = self.view("records", "get", clip.record_id)["expires_at_ms"]
        self.block([])

    def status(self, clip: RecordedClip) -> str:
        return str(self.view("records", "get", clip.record_id)["status"])

    def remove(self, name: str) -> None:
        self.must(self.admin, "membership", "propose", "remove_node", {"name": name})

    def add(self, name: str) -> None:
        self.must(self.admin, "membership", "propose", "add_node", node_arguments(name, key_of(name)))


def node_arguments(name: str, key: PrivateKey) -> dict[str, Any]:
    return {
        "name": name,
        "organisation": "ward",
        "host": "127.0.0.1",
        "p2p_port": 9,
        "api_url": "http://127.0.0.1:9",
        "producer_key": b"",
        "producer_possession": b"",
        "custodian_key": key.public_key,
    }


@asynccontextmanager
async def ward_with(directory: Path, *holders: str) -> AsyncIterator[tuple[Ward, RecordedClip]]:
    """A ward with one record that has expired, and whose clip only these custodians had."""
    async with AsyncExitStack() as opened:
        ward = Ward(directory, opened)
        for name in NAMES:
            await ward.open_custody(name)
        clip = await ward.record_of(*holders)
        ward.pass_time(clip)
        yield ward, clip


async def test_each_custodian_reports_once_and_it_is_erased(tmp_path: Path) -> None:
    async with ward_with(tmp_path, *NAMES) as (ward, clip):
        await ward.settle()
        assert ward.status(clip) == "erased"
        told = [each for each in ward.view("audit", "events", _owner(ward, clip), 0, 99) if each["kind"] == "expired"]
        assert len(told) == len(NAMES)


async def test_one_that_never_had_the_clip_reports_too(tmp_path: Path) -> None:
    async with ward_with(tmp_path, *NAMES[:2]) as (ward, clip):
        await ward.settle()
        assert ward.status(clip) == "erased"


async def test_it_is_not_erased_while_a_custodian_is_silent_and_is_once_that_one_is_removed(tmp_path: Path) -> None:
    async with ward_with(tmp_path, *NAMES) as (ward, clip):
        await ward.settle(NAMES[2])
        assert ward.status(clip) == "expired"
        ward.remove(NAMES[2])
        await ward.settle()
        assert ward.status(clip) == "erased"


async def test_it_is_erased_when_one_that_had_reported_is_removed_before_the_others_speak(tmp_path: Path) -> None:
    async with ward_with(tmp_path, *NAMES) as (ward, clip):
        await ward.settle(*NAMES[1:])
        ward.remove(NAMES[0])
        await ward.settle(NAMES[2])
        assert ward.status(clip) == "expired", "the third has said nothing"
        await ward.settle()
        assert ward.status(clip) == "erased"


async def test_one_that_came_after_the_first_report_owes_none(tmp_path: Path) -> None:
    async with ward_with(tmp_path, *NAMES) as (ward, clip):
        await ward.settle(*NAMES[1:])
        ward.add("custodian-4")
        await ward.settle()
        assert ward.status(clip) == "erased"


async def test_one_that_came_before_the_first_report_says_that_it_has_nothing(tmp_path: Path) -> None:
    async with ward_with(tmp_path, *NAMES) as (ward, clip):
        ward.add("custodian-4")
        await ward.settle("custodian-4")
        assert ward.status(clip) == "expired", "the fourth may have had it, too"
        await ward.open_custody("custodian-4")
        await ward.settle()
        assert ward.status(clip) == "erased"


async def test_one_whose_store_was_lost_before_it_reported_says_that_it_has_nothing(tmp_path: Path) -> None:
    async with ward_with(tmp_path, *NAMES) as (ward, clip):
        await ward.settle(NAMES[2])
        ward.directory = tmp_path / "new"
        await ward.open_custody(NAMES[2])
        await ward.settle()
        assert ward.status(clip) == "erased"


def _owner(ward: Ward, clip: RecordedClip) -> bytes:
    return bytes(ward.view("records", "get", clip.record_id)["owner"])
