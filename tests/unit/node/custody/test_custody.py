"""The custodian's tie to the chain: every block once and in order, what is owed is submitted until it is seen."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace
from typing import Any

import pytest

from consensus.chain.block import Block, FinalityProof, Header, QuorumCertificate, Receipt, Receipts
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.limits import DAY_MS
from consensus.primitives.encoding import decode, encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, FrameDownload
from consensus.records.sharing import SharedRequest
from consensus.state.identity import CUSTODIAN, ROOM, CustodianRow, RoomRow
from node.custody.coordination.custody_answers import WorkFailure
from node.custody.coordination.custody_coordinator import (
    CLIP_PART_BYTES,
    OUTBOX_BATCH_COUNT,
    OUTBOX_LIFETIME_MS,
    REFUSALS_MAX_COUNT,
    CustodyCoordinator,
    PeerLink,
)
from node.custody.coordination.work_failures import SHOWN_MAX_MS, WorkFailures
from node.custody.stores.custody_store import Checkpoint, OutboxRow
from node.ledger.ledger_writer import FinalityFeed
from node.mempool.transaction_pool import SubmitResult
from node.p2p.wire import ClipPart, ClipRequest, RequestKind
from node.storage.ledger_store import FinalizedBlock
from node.storage.memory_store import MemoryStore

KEY = PrivateKey(sha256(b"custodian"))
ROW = OutboxRow("receipt", bytes(32), 0, "erasure", "receipt", encode_value([bytes(32), 1]), 1)
IS_CUSTODIAN = {CUSTODIAN.key(KEY.public_key): CUSTODIAN.encode(CustodianRow("node-1", "ward"))}
PROOF = FinalityProof(b"", b"", QuorumCertificate(epoch=0, round=0, block_id=b"", votes=()))


class ScriptedCustodian:
    """Remembers what it was told; owes what the test says."""

    def __init__(self) -> None:
        self.heights: list[int] = []
        self.rows: list[OutboxRow] = [ROW]
        self.dismissed: list[OutboxRow] = []
        self.fails_once_at: int | None = None
        self.is_down = False
        self.clip: ClipDownload | None = None
        self.refusal = "NOT_FOUND"

    async def start(self) -> None:
        """Nothing was cut off."""

    async def checkpoint(self) -> Checkpoint | None:
        return Checkpoint(self.heights[-1], bytes(32), 1) if self.heights else None

    async def on_finalized_blocks(self, blocks: Any) -> None:
        if self.is_down:
            raise BlockRobotError("STORE_UNAVAILABLE", "No server.")
        for events in blocks:
            if events.height == self.fails_once_at:
                self.fails_once_at = None
                raise BlockRobotError("STORE_UNAVAILABLE")
            if events.height not in self.heights:
                self.heights.append(events.height)

    async def ready_outbox(self, limit: int) -> list[OutboxRow]:
        return self.rows[:limit]

    async def dismiss(self, row: OutboxRow) -> None:
        self.dismissed.append(row)
        self.rows.remove(row)

    async def export(self, record_id: bytes) -> ClipDownload:
        await self.require_exportable(record_id)
        assert self.clip is not None
        return self.clip

    async def require_exportable(self, record_id: bytes) -> None:
        if self.clip is None:
            raise BlockRobotError(self.refusal)

    async def follow_placement(self) -> int:
        return 0

    async def fetch_missing(self, links: Any) -> int:
        return 0


class Pool:
    """Takes all that is submitted."""

    def __init__(self) -> None:
        self.wires: list[bytes] = []

    async def submit(self, wires: Any) -> list[SubmitResult]:
        self.wires += wires
        return [SubmitResult(decode_transaction(wire).txid, None) for wire in wires]


class Rig:
    """A custody over a memory store whose blocks the test makes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("node.custody.coordination.custody_coordinator.RETRY_MS", 0)
        self.now_ms = 1_000_000
        self.custodian, self.pool, self.ledger = ScriptedCustodian(), Pool(), MemoryStore()
        self.ledger._tables.state.apply(IS_CUSTODIAN)
        self.feed = FinalityFeed(-1)
        custodians = tuple(SimpleNamespace(name=name, custodian_key=name.encode()) for name in ("node-1", "node-2"))
        self.custody = CustodyCoordinator(
            genesis=SimpleNamespace(chain_id=bytes(32), custodians=custodians),  # type: ignore[arg-type]
            name="node-1",
            custodian=self.custodian,  # type: ignore[arg-type]
            key=KEY,
            ledger=self.ledger,
            feed=self.feed,
            pool=self.pool,  # type: ignore[arg-type]
            peers=SimpleNamespace(connected=[]),  # type: ignore[arg-type]
            clock=lambda: self.now_ms,
        )

    async def finalize(
        self, height: int, *receipts: Receipt, writes: Mapping[bytes, bytes | None] = MappingProxyType({})
    ) -> None:
        block = _block(height)
        position = await self.ledger.commit(
            [
                FinalizedBlock(
                    height=height,
                    block_id=block.block_id,
                    block_bytes=encode(block),
                    receipts_bytes=encode(Receipts(receipts)),
                    timestamp_ms=height + 1,
                    state_root=bytes(32),
                    state_writes=writes,
                )
            ],
            b"",
        )
        self.feed.publish([], PROOF, position)

    async def followed(self, height: int) -> None:
        async with asyncio.timeout(5), self.custody._followed:
            await self.custody._followed.wait_for(lambda: (self.custody.checkpoint_height or 0) >= height)


def _block(height: int) -> Block:
    qc = QuorumCertificate(epoch=0, round=0, block_id=bytes(32), votes=())
    zero = bytes(32)
    header = Header(1, zero, 0, height, height, zero, qc, None, 0, height + 1, zero, zero, zero, None, 0)
    return Block(header_bytes=encode(header), signature=b"", transactions=())


def _refusal(txid: bytes, code: str) -> Receipt:
    return Receipt(txid=txid, ok=False, code=code, message="", line=None, gas_used=1, events=())


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Rig:
    return Rig(monkeypatch)


async def test_a_custodian_that_was_down_hears_of_every_block_once_and_in_order(rig: Rig) -> None:
    for height in range(5):
        await rig.finalize(height)
    rig.custodian.heights = [0, 1]
    await rig.custody.start()
    await rig.followed(4)
    await rig.finalize(5)
    await rig.followed(5)
    await rig.custody.stop()
    assert rig.custodian.heights == [0, 1, 2, 3, 4, 5]


async def test_a_store_that_does_not_answer_is_asked_again_and_no_block_is_left_out(rig: Rig) -> None:
    rig.custodian.fails_once_at = 1
    for height in range(3):
        await rig.finalize(height)
    await rig.custody.start()
    await rig.followed(2)
    await rig.custody.stop()
    assert rig.custodian.heights == [0, 1, 2]


async def test_what_fails_is_told_with_reason_and_time_until_it_goes_again(rig: Rig) -> None:
    rig.custodian.is_down = True
    await rig.finalize(0)
    await rig.custody.start()
    for waited_ms in (0, *[60_000] * 5):
        rig.now_ms += waited_ms
        for _ in range(10):
            await asyncio.sleep(0)
    assert rig.custody.failing.describe() == [WorkFailure("following", "STORE_UNAVAILABLE", "No server.", 300)]
    assert rig.custody.failing.code == "STORE_UNAVAILABLE"
    with pytest.raises(BlockRobotError, match="No server"):
        rig.custody.failing.require_following()
    rig.custodian.is_down = False
    await rig.finalize(1)
    await rig.followed(1)
    await rig.custody.stop()
    assert (rig.custody.failing.describe(), rig.custody.failing.code) == ([], None)
    rig.custody.failing.require_following()


def test_only_a_custodians_own_failures_count_and_only_while_they_are_new() -> None:
    now_ms = 0
    failing = WorkFailures(lambda: now_ms)
    for code in ("UPLOAD_QUOTA_EXCEEDED", "STORE_UNAVAILABLE", "UPLOAD_INVALID"):
        with pytest.raises(BlockRobotError), failing.noted("uploads"):
            raise BlockRobotError(code)
    assert [row.code for row in failing.describe()] == ["STORE_UNAVAILABLE"]
    failing.require_following()
    now_ms = SHOWN_MAX_MS + 1
    assert failing.describe() == []


async def test_what_a_custodian_signed_by_a_clock_an_hour_ahead_is_signed_anew_once_the_clock_is_right(
    rig: Rig,
) -> None:
    rig.now_ms += 3_600_000
    await rig.custody._submit_due()
    rig.now_ms -= 3_600_000
    await rig.custody._submit_due()
    await rig.custody._submit_due()
    expiries = [decode_transaction(wire).body.valid_until_ms for wire in rig.pool.wires]
    assert expiries == [rig.now_ms + 3_600_000 + OUTBOX_LIFETIME_MS, rig.now_ms + OUTBOX_LIFETIME_MS]


async def test_what_is_owed_is_signed_by_the_custodian_and_submitted_again_only_after_it_expired(rig: Rig) -> None:
    await rig.custody._submit_due()
    await rig.custody._submit_due()
    assert len(rig.pool.wires) == 1
    transaction = decode_transaction(rig.pool.wires[0])
    transaction.verify_sender()
    assert transaction.body.sender == KEY.public_key
    assert (transaction.body.contract, transaction.body.entry) == ("erasure", "receipt")
    rig.now_ms += OUTBOX_LIFETIME_MS
    await rig.custody._submit_due()
    assert len(rig.pool.wires) == 2
    assert rig.pool.wires[0] != rig.pool.wires[1]


async def test_one_that_is_no_custodian_of_the_chain_signs_nothing_and_owes_it_still_when_it_is_one_again(
    rig: Rig,
) -> None:
    """Its own node's pool refuses what it signs: it signed all that it owed anew each second."""
    rig.custody._room_gib = 4_000
    await rig.finalize(0, writes=dict.fromkeys(IS_CUSTODIAN))
    await rig.custody._submit_due()
    assert rig.pool.wires == []
    await rig.finalize(1, writes=IS_CUSTODIAN)
    await rig.custody._submit_due()
    assert [decode_transaction(wire).body.entry for wire in rig.pool.wires] == ["declare_room", "receipt"]


async def test_one_that_was_removed_takes_no_upload_that_a_robot_would_count_as_a_copy(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = "node.custody.coordination.upload_admission"
    monkeypatch.setattr(f"{place}.CATCH_UP_MAX_MS", 0)
    monkeypatch.setattr(f"{place}.may_upload", lambda *_: True)
    await rig.finalize(0)
    await rig.custody.admission.wait_for_visit(bytes(16), bytes(33), KEY.public_key)
    await rig.finalize(1, writes=dict.fromkeys(IS_CUSTODIAN))
    with pytest.raises(BlockRobotError, match="CUSTODY_ELSEWHERE"):
        await rig.custody.admission.wait_for_visit(bytes(16), bytes(33), KEY.public_key)


@pytest.mark.parametrize(
    "later",
    [
        pytest.param(replace(ROW, arguments=encode_value([b"later"])), id="of a clip that is fetched later"),
        pytest.param(replace(ROW, height=ROW.height + 1), id="the same again, since a custodian was removed"),
    ],
)
async def test_another_word_in_the_place_of_one_that_was_settled_waits_for_nothing(rig: Rig, later: OutboxRow) -> None:
    """Their keys are the same: it was owed for a minute."""
    await rig.custody._submit_due()
    rig.custodian.rows = [later]
    for _ in range(2):
        await rig.custody._submit_due()
    assert len(rig.pool.wires) == 2
    await rig.custody._note_refusals([_refusal(decode_transaction(rig.pool.wires[0]).txid, "RELEASE_EXISTS")])
    assert rig.custodian.dismissed == [], "what was said of the first is not said of the second"


@pytest.mark.parametrize("code", ["RECEIPT_EXISTS", "RELEASE_EXISTS", "REFUSAL_EXISTS", "NOT_A_CUSTODIAN"])
async def test_what_the_chain_knows_already_or_asked_others_is_dismissed_at_once(rig: Rig, code: str) -> None:
    await rig.custody._submit_due()
    await rig.custody._note_refusals([_refusal(decode_transaction(rig.pool.wires[0]).txid, code)])
    assert rig.custodian.dismissed == [ROW]


async def test_what_is_dismissed_while_the_next_round_of_submissions_goes_out_is_no_fault(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    await rig.custody._submit_due()
    dismiss = rig.custodian.dismiss

    async def dismiss_slowly(row: OutboxRow) -> None:
        await dismiss(row)
        await rig.custody._submit_due()

    monkeypatch.setattr(rig.custodian, "dismiss", dismiss_slowly)
    await rig.custody._note_refusals([_refusal(decode_transaction(rig.pool.wires[0]).txid, "RECEIPT_EXISTS")])
    assert rig.custodian.dismissed == [ROW]


async def test_what_a_contract_refuses_is_tried_a_few_times_and_then_dismissed(rig: Rig) -> None:
    for attempt in range(REFUSALS_MAX_COUNT):
        assert rig.custodian.dismissed == []
        await rig.custody._submit_due()
        assert len(rig.pool.wires) == attempt + 1
        await rig.custody._note_refusals([_refusal(decode_transaction(rig.pool.wires[-1]).txid, "RECEIPT_WRONG")])
    assert rig.custodian.dismissed == [ROW]


async def test_what_others_are_submitted_before_is_not_signed_again_and_its_refusals_are_counted(rig: Rig) -> None:
    """Only the first rows were remembered: a word behind 64 receipts was signed anew, and never dismissed."""
    receipts = [replace(ROW, part=1 + part) for part in range(OUTBOX_BATCH_COUNT)]
    for attempt in range(REFUSALS_MAX_COUNT):
        await rig.custody._submit_due()
        sent = len(rig.pool.wires)
        txid = decode_transaction(rig.pool.wires[-1]).txid
        rig.custodian.rows[:0] = receipts
        await rig.custody._submit_due()
        assert len(rig.pool.wires) == sent + (0 if attempt else len(receipts))
        del rig.custodian.rows[: len(receipts)]
        await rig.custody._submit_due()
        assert len(rig.pool.wires) == sent + (0 if attempt else len(receipts)), "it is on its way still"
        assert rig.custodian.dismissed == []
        await rig.custody._note_refusals([_refusal(txid, "RECEIPT_WRONG")])
        rig.custodian.rows[:0] = receipts
        await rig.custody._submit_due()
        del rig.custodian.rows[: len(receipts)]
    assert rig.custodian.dismissed == [ROW]
    rig.now_ms += OUTBOX_LIFETIME_MS
    await rig.custody._submit_due()
    assert rig.custody._submitted == {}, "what expired and was never refused is forgotten"


async def test_a_large_clip_comes_over_in_parts_and_whole(rig: Rig) -> None:
    frames = [FrameDownload(number, False, bytes([number]) * 70_000, bytes(80)) for number in range(32)]
    rig.custodian.clip = ClipDownload(bytes(16), bytes(32), frames, [], [])
    asked: list[int] = []

    async def request(peer: str, kind: RequestKind, body: bytes) -> bytes:
        asked.append(decode(body, ClipRequest).offset)
        return await rig.custody.serve_peer("node-2", kind, body)

    link = PeerLink("node-1", SimpleNamespace(request=request))  # type: ignore[arg-type]
    assert await link.fetch(bytes(16)) == rig.custodian.clip
    assert asked == [0, CLIP_PART_BYTES, 2 * CLIP_PART_BYTES]
    rig.custodian.clip = None
    assert await link.fetch(bytes(16)) is None


@pytest.mark.parametrize("code", ["CLIP_ERASED", "CLIP_QUARANTINED", "NOT_FOUND"])
async def test_what_is_erased_or_quarantined_between_two_parts_does_not_leave_and_is_forgotten(
    rig: Rig, code: str
) -> None:
    frames = [FrameDownload(number, False, bytes([number]) * 70_000, bytes(80)) for number in range(32)]
    rig.custodian.clip = ClipDownload(bytes(16), bytes(32), frames, [], [])
    first = encode(ClipRequest(record_id=bytes(16), offset=0))
    assert decode(await rig.custody.serve_peer("node-2", RequestKind.CLIP, first), ClipPart).data
    assert rig.custody._served
    rig.custodian.clip, rig.custodian.refusal = None, code
    following = encode(ClipRequest(record_id=bytes(16), offset=CLIP_PART_BYTES))
    if code == "CLIP_QUARANTINED":
        with pytest.raises(BlockRobotError, match=code):
            await rig.custody.serve_peer("node-2", RequestKind.CLIP, following)
    else:
        part = decode(await rig.custody.serve_peer("node-2", RequestKind.CLIP, following), ClipPart)
        assert (part.total, part.data) == (0, b"")
    assert not rig.custody._served


async def test_nobody_but_a_custodian_gets_a_clip(rig: Rig) -> None:
    with pytest.raises(BlockRobotError, match=r"^PEER_REFUSED:"):
        await rig.custody.serve_peer("node-3", RequestKind.CLIP, encode(ClipRequest(bytes(16), 0)))


@pytest.mark.parametrize("part", [ClipPart(100, b""), ClipPart(100, b"x"), ClipPart(CLIP_PART_BYTES + 1, b"x" * 9)])
async def test_a_peer_that_sends_less_than_it_announces_is_not_waited_for(part: ClipPart) -> None:
    """Byte by byte, each in time, a clip would take years."""

    async def request(*_: Any) -> bytes:
        return encode(part)

    link = PeerLink("node-1", SimpleNamespace(request=request))  # type: ignore[arg-type]
    with pytest.raises(BlockRobotError, match=r"^PEER_MESSAGE_INVALID:"):
        await link.fetch(bytes(16))


async def test_no_clip_leaves_before_the_custodian_has_followed_the_network_since_its_start(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its disk may be of an old backup: what was erased since is erased here first, and only then does it serve."""
    monkeypatch.setattr("node.custody.coordination.custody_coordinator.CATCH_UP_MAX_MS", 0)
    in_touch = False
    rig.custody._is_in_touch = lambda: in_touch
    rig.custodian.clip = ClipDownload(bytes(16), bytes(32), [], [], [])
    ask = encode(ClipRequest(record_id=bytes(16), offset=0))
    for height in range(3):
        await rig.finalize(height)
    rig.custodian.heights = [0]
    for state in ("alone", "in touch, behind"):
        assert not rig.custody.is_serving, state
        for attempt in (
            rig.custody.download(bytes(16), bytes(32), bytes(33)),
            rig.custody.get_background(bytes(32)),
            rig.custody.serve_peer("node-2", RequestKind.CLIP, ask),
        ):
            with pytest.raises(BlockRobotError, match=r"^CUSTODY_CATCHING_UP:"):
                await attempt
        in_touch = True
    await rig.custody.start()
    await rig.followed(2)
    assert rig.custody.is_serving
    assert decode(await rig.custody.serve_peer("node-2", RequestKind.CLIP, ask), ClipPart).total > 0
    in_touch = False
    await rig.finalize(3)
    assert rig.custody.is_serving, "one that has followed goes on serving while it is cut off"
    await rig.custody.stop()


@pytest.mark.parametrize("ask_for", ["clip", "shared clip", "empty frame", "peer's part"])
async def test_nothing_leaves_while_a_final_block_is_not_followed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, ask_for: str
) -> None:
    """In that block a visit may have been denied, a record erased, an approval withdrawn."""
    monkeypatch.setattr("node.custody.coordination.custody_coordinator.CATCH_UP_MAX_MS", 0)
    asked: list[str] = []

    async def give(*_: Any) -> ClipDownload:
        asked.append(ask_for)
        return ClipDownload(bytes(16), bytes(32), [], [], [])

    monkeypatch.setattr("node.custody.coordination.custody_coordinator.require_grantee", lambda *_: None)
    for name in ("download", "download_shared", "get_background"):
        monkeypatch.setattr(rig.custodian, name, give, raising=False)
    rig.custodian.clip = ClipDownload(bytes(16), bytes(32), [], [], [])
    shared = SharedRequest(bytes(16), bytes(32), bytes(32), bytes(32), with_frames=True)
    part = encode(ClipRequest(record_id=bytes(16), offset=0))

    async def ask() -> object:
        if ask_for == "clip":
            return await rig.custody.download(bytes(16), bytes(32), bytes(33))
        if ask_for == "shared clip":
            return await rig.custody.download_shared(shared, bytes(32), bytes(33))
        if ask_for == "empty frame":
            return await rig.custody.get_background(bytes(32))
        return await rig.custody.serve_peer("node-2", RequestKind.CLIP, part)

    for height in range(2):
        await rig.finalize(height)
    await rig.custody.start()
    await rig.followed(1)
    assert await ask()
    held = asyncio.Event()
    follow = rig.custodian.on_finalized_blocks

    async def slow(events: Any) -> None:
        await held.wait()
        await follow(events)

    monkeypatch.setattr(rig.custodian, "on_finalized_blocks", slow)
    await rig.finalize(2)
    before = len(asked)
    with pytest.raises(BlockRobotError, match="CUSTODY_CATCHING_UP"):
        await ask()
    assert len(asked) == before
    monkeypatch.setattr("node.custody.coordination.custody_coordinator.CATCH_UP_MAX_MS", 5_000)
    waiting = asyncio.create_task(ask())
    await asyncio.sleep(0)
    held.set()
    assert await waiting
    await rig.custody.stop()


async def test_blocks_that_are_final_and_not_stored_yet_are_followed_too_before_a_clip_leaves(rig: Rig) -> None:
    """The node is level with the others by what it knows to be final: of that its disk may have only a part."""
    known = 2
    rig.custody._final_height = lambda: known
    await rig.finalize(0)
    await rig.custody.start()
    assert not rig.custody.is_serving
    await rig.finalize(1)
    await rig.followed(1)
    assert not rig.custody.is_serving
    await rig.finalize(2)
    await rig.followed(2)
    assert rig.custody.is_serving
    known = 9
    assert rig.custody.is_serving, "one that has followed goes on serving"
    await rig.custody.stop()


async def test_after_a_block_no_part_of_a_clip_is_as_it_was_kept_before(rig: Rig) -> None:
    """The block may have erased frames: the next part is read anew, and of the old ones memory holds nothing."""
    frames = [FrameDownload(number, False, bytes([number]) * 70_000, bytes(80)) for number in range(32)]
    rig.custodian.clip = ClipDownload(bytes(16), bytes(32), frames, [], [])
    await rig.finalize(0)
    await rig.finalize(1)
    await rig.custody.start()
    await rig.followed(1)
    first = encode(ClipRequest(record_id=bytes(16), offset=0))
    await rig.custody.serve_peer("node-2", RequestKind.CLIP, first)
    assert rig.custody._served
    rig.custodian.clip = ClipDownload(bytes(16), bytes(32), frames[:20], [], [])
    await rig.finalize(2)
    await rig.followed(2)
    assert not rig.custody._served
    following = encode(ClipRequest(record_id=bytes(16), offset=CLIP_PART_BYTES))
    part = decode(await rig.custody.serve_peer("node-2", RequestKind.CLIP, following), ClipPart)
    assert part.total == len(encode(rig.custodian.clip))
    await rig.custody.stop()


def room_calls(rig: Rig) -> list[list[Any]]:
    calls = [decode_transaction(wire) for wire in rig.pool.wires]
    return [call.arguments() for call in calls if call.body.entry == "declare_room"]


async def test_a_custodian_declares_the_room_of_its_configuration_once_a_day(rig: Rig) -> None:
    rig.custody._room_gib = 4_000
    await rig.custody._submit_due()
    await rig.custody._submit_due()
    assert room_calls(rig) == [[4_000]]
    rig.now_ms += OUTBOX_LIFETIME_MS
    await rig.custody._submit_due()
    assert room_calls(rig) == [[4_000]] * 2, "the first never became final"
    await rig.finalize(0, writes={ROOM.key(KEY.public_key): ROOM.encode(RoomRow(4_000, rig.now_ms))})
    rig.now_ms += OUTBOX_LIFETIME_MS
    await rig.custody._submit_due()
    rig.custody._room_gib = 0
    await rig.custody._submit_due()
    assert len(room_calls(rig)) == 2
    rig.now_ms += DAY_MS
    await rig.custody._submit_due()
    assert room_calls(rig)[2:] == [[0]]
