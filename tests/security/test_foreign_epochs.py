"""A peer that speaks of epochs that are not: forged steps, words of far futures, claims to be ahead. All cost it alone."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from consensus.chain.block import EpochProof, FinalityProof, QuorumCertificate
from consensus.chain.messages import CertificateNotice
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from node.consensus.epoch_change import BUFFERED_MESSAGES_PER_PEER_MAX_BYTES, BUFFERED_MESSAGES_PER_PEER_MAX_COUNT
from node.p2p.wire import BlockBatch, FrameKind, HeightNotice, RequestKind
from tests.unit.node.small_nodes import SmallNodes, make_genesis
from tests.virtual_time import in_virtual_time, virtual_now_ms

pytestmark = pytest.mark.smoke

NAMES = ["a", "b", "c", "liar"]
THIEF = PrivateKey(sha256(b"thief")).public_key


def _call(crowd: SmallNodes) -> Any:
    return crowd.transaction("identity", "authenticate", bytes(32))


def _tell(crowd: SmallNodes, kind: FrameKind, payload: bytes) -> None:
    crowd.links["a"].handler.peer_frame("liar", kind, payload)


def _refusal(crowd: SmallNodes, proof: EpochProof) -> str:
    with pytest.raises(BlockRobotError) as refusal:
        _tell(crowd, FrameKind.EPOCH, encode(proof))
    return refusal.value.code


def _notice(epoch: int, round_number: int = 1) -> bytes:
    qc = QuorumCertificate(epoch=epoch, round=round_number, block_id=bytes(32), votes=())
    return encode(CertificateNotice(qc=qc, entered_by=None))


@in_virtual_time
async def test_a_forged_step_into_another_epoch_costs_the_liar_its_connection_and_moves_nobody() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await crowd.finalize("b", _call(crowd))
    await crowd.finalize("a", _call(crowd))
    node = crowd.nodes["a"]
    with crowd.ledgers["a"].snapshot() as snapshot:
        genuine = decode(snapshot.finality, FinalityProof)
    stolen = msgspec.structs.replace(crowd.genesis.epoch, number=1, producers=(THIEF,))
    assert _refusal(crowd, EpochProof(genuine, stolen)) == "PROOF_INVALID"
    weak = msgspec.structs.replace(genuine.child_qc, votes=genuine.child_qc.votes[:-1])
    proof = EpochProof(msgspec.structs.replace(genuine, child_qc=weak), stolen)
    assert _refusal(crowd, proof) == "CERTIFICATE_INVALID"
    header = msgspec.structs.replace(node.core.finalized, next_schedule_hash=bytes(32))
    proof = EpochProof(msgspec.structs.replace(genuine, header_bytes=encode(header)), stolen)
    assert _refusal(crowd, proof) == "PROOF_INVALID"
    await asyncio.sleep(1)
    assert (node.core.epoch, node.sync.blocks_installed_count) == (0, 0)
    await crowd.finalize("a", _call(crowd))
    await crowd.stop()


@in_virtual_time
async def test_the_step_that_was_decided_cannot_be_exchanged_for_another_with_the_same_boundary() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    crowd.cut_off = {"a"}
    await crowd.finalize("b", crowd.transaction("settings", "propose", "base_timeout_ms", 400))
    await crowd.wait_epoch(1, "b", "c", "liar")
    with crowd.ledgers["b"].snapshot() as snapshot:
        genuine = decode(snapshot.epoch_proof(1) or b"", EpochProof)
    stolen = msgspec.structs.replace(genuine.epoch, producers=(THIEF, *genuine.epoch.producers[1:]))
    assert _refusal(crowd, EpochProof(genuine.finality, stolen)) == "PROOF_INVALID"
    skipped = EpochProof(genuine.finality, msgspec.structs.replace(genuine.epoch, number=1, leaderless=(0,)))
    assert _refusal(crowd, skipped) == "PROOF_INVALID"
    assert crowd.nodes["a"].core.epoch == 0
    crowd.heal()
    await crowd.wait_epoch(1, timeout_s=10)
    await crowd.finalize("a", _call(crowd))
    await crowd.stop()


@in_virtual_time
async def test_words_of_epochs_that_are_not_fill_no_memory_and_stop_nobody_from_voting() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    node, asked = crowd.nodes["a"], []
    serve = crowd.links["liar"].handler.peer_request

    async def stall(peer: str, kind: RequestKind, body: bytes) -> bytes:
        asked.append(kind)
        if kind is RequestKind.FINALIZED:
            return encode(BlockBatch(blocks=(), proof=None))
        return await serve(peer, kind, body)

    crowd.links["liar"].handler.peer_request = stall  # type: ignore[method-assign]
    started_ms = virtual_now_ms()
    for number in range(2_000):
        _tell(crowd, FrameKind.NOTICE, _notice(1 + number % 2, 1 + number))
        _tell(crowd, FrameKind.HEIGHT, encode(HeightNotice(finalized_height=0, epoch=7)))
        if number % 100 == 0:
            assert not node.sync.closes_gap
            await crowd.finalize("a", _call(crowd))
            await asyncio.sleep(0.1)
    words = node.peers._epoch_transition._kept["liar"]
    assert len(words) <= BUFFERED_MESSAGES_PER_PEER_MAX_COUNT
    assert sum(len(payload) for _, payload in words) <= BUFFERED_MESSAGES_PER_PEER_MAX_BYTES
    assert 1 <= asked.count(RequestKind.FINALIZED) <= 2 + (virtual_now_ms() - started_ms) // 1_000
    assert {node.core.epoch for node in crowd.nodes.values()} == {0}
    assert node.is_ready()
    await crowd.finalize("a", crowd.transaction("settings", "propose", "base_timeout_ms", 400))
    await crowd.wait_epoch(1)
    await crowd.finalize("a", _call(crowd))
    await crowd.stop()
