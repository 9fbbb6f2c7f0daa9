"""A bundle's chain, followed through changes of its producers: old proofs stay good, and no step can be left out."""

from __future__ import annotations

import msgspec
import pytest

from clients.bundle.checks.chain_proofs import ProvedChain
from clients.bundle.documents import ReceiptProof
from consensus.chain.block import Block, FinalityProof, Receipt, compute_receipts_root, compute_transactions_root
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from tests.unit.consensus.many_epochs import GENESIS_FILE, ManyEpochs, renamed
from tests.unit.consensus.one_core import Peers


class Story:
    """A chain over three epochs, with a final block proved in each."""

    def __init__(self) -> None:
        chain = ManyEpochs()
        self.epochs: list[str] = []
        self.proofs: list[bytes] = []
        for first_key in (3, 6):
            self.proofs.append(encode(chain.prove(chain.grow(2))))
            self.epochs.append(encode(chain.change(first_key)).hex())
        self.proofs.append(encode(chain.prove(chain.grow())))
        self.chain = chain


STORY = Story()


def test_proofs_of_every_epoch_are_good_in_any_order() -> None:
    for order in (STORY.proofs, STORY.proofs[::-1]):
        chain = ProvedChain(GENESIS_FILE, STORY.epochs)
        assert [chain.final(raw).epoch for raw in order] == sorted([0, 1, 2], reverse=order is not STORY.proofs)
        assert chain.epoch_count == 3


@pytest.mark.parametrize("count", [0, 1])
def test_a_proof_of_an_epoch_that_nothing_leads_to_is_refused(count: int) -> None:
    chain = ProvedChain(GENESIS_FILE, STORY.epochs[:count])
    assert [chain.final(raw).epoch for raw in STORY.proofs[: count + 1]] == list(range(count + 1))
    with pytest.raises(BlockRobotError, match=r"^PROOF_OTHER_EPOCH:"):
        chain.final(STORY.proofs[-1])


@pytest.mark.parametrize("steps", [[1], [1, 0], [0, 0], [0, 1, 1]])
def test_steps_are_not_skipped_turned_round_or_doubled(steps: list[int]) -> None:
    with pytest.raises(BlockRobotError):
        ProvedChain(GENESIS_FILE, [STORY.epochs[step] for step in steps])


def test_a_step_that_its_maker_invents_is_refused() -> None:
    other = ManyEpochs()
    invented = encode(renamed(other.change(3), producers=other.change(5).epoch.producers)).hex()
    with pytest.raises(BlockRobotError):
        ProvedChain(GENESIS_FILE, [invented])


def test_two_final_blocks_of_one_height_are_refused_even_if_both_are_proved() -> None:
    """Only more faulty producers than the chain tolerates can do that; the bundle is no proof of anything then."""
    one, other = ManyEpochs(), ManyEpochs()
    first = encode(one.prove(one.grow(1)))
    other.blocks.append(other.peers.block(2, other.blocks[-1], tc=other.peers.tc(1, 0)))
    second = encode(other.prove(other.blocks[-1]))
    chain = ProvedChain(GENESIS_FILE, [])
    assert chain.final(first).height == 1
    with pytest.raises(BlockRobotError, match="Two different blocks"):
        chain.final(second)


def test_a_proof_is_checked_once_and_as_its_bytes() -> None:
    chain = ProvedChain(GENESIS_FILE, [])
    assert chain.final(STORY.proofs[0]) is chain.final(STORY.proofs[0])
    for spoilt in (STORY.proofs[0] + b"\0", STORY.proofs[0][:-1], b"", msgspec.msgpack.encode([])):
        with pytest.raises(BlockRobotError):
            chain.final(spoilt)


RECEIPT = Receipt(txid=sha256(b"transaction"), ok=True, code="OK", message="", line=None, gas_used=0, events=())
WITH_RECEIPT = {
    "receipts_root": compute_receipts_root((RECEIPT,)),
    "transactions_root": compute_transactions_root([RECEIPT.txid]),
}


def receipt_proof(headers: list[Block], child: Block, peers: Peers) -> ReceiptProof:
    finality = FinalityProof(
        header_bytes=headers[-1].header_bytes, child_header_bytes=child.header_bytes, child_qc=peers.qc(child)
    )
    return ReceiptProof(
        headers=[block.header_bytes.hex() for block in headers],
        finality=encode(finality).hex(),
        receipt=encode(RECEIPT).hex(),
        index=0,
        count=1,
        receipt_path=[],
        transaction_path=[],
    )


def test_a_receipt_stands_in_a_block_below_a_final_one_and_in_no_other_that_its_maker_writes() -> None:
    peers = ManyEpochs().peers
    one = peers.block(1, **WITH_RECEIPT)
    two, other = peers.block(2, one), peers.block(2, peers.block(1))
    proved = ProvedChain(GENESIS_FILE, []).receipt("x", receipt_proof([one, two], peers.block(3, two), peers))
    assert (proved.receipt, proved.height) == (RECEIPT, 1)
    with pytest.raises(BlockRobotError, match="do not follow each other"):
        ProvedChain(GENESIS_FILE, []).receipt("x", receipt_proof([one, other], peers.block(3, other), peers))
