"""R8, R19, R20: what convinces a client that trusts only the genesis file."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.block import FinalityProof, Header, IndexedSignature
from consensus.chain.genesis import ChainSettings, Genesis, NodeEntry
from consensus.chain.light_client import LightClient, verify_finality
from consensus.chain.messages import sign_vote
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.trie import Proof, hash_page, hash_value
from tests.sim.named_chain import CHAIN_ID
from tests.unit.consensus.one_core import GENESIS, Peers

PEERS = Peers()


def proof_of(block, child, child_qc=None):
    return FinalityProof(
        header_bytes=block.header_bytes, child_header_bytes=child.header_bytes, child_qc=child_qc or PEERS.qc(child)
    )


def verified(proof):
    return verify_finality(proof, PEERS.schedule, CHAIN_ID, GENESIS.block_id)


def refused(proof, code):
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        verified(proof)


def test_a_header_is_final_by_a_certified_child_of_the_next_round_alone():
    one, two = PEERS.chain(1, 2)
    assert verified(proof_of(one, two)) == one.header
    assert verified(proof_of(GENESIS, PEERS.block(1))) == GENESIS.header
    one, three = PEERS.chain(1, 3)
    refused(proof_of(one, three), "PROOF_INVALID")
    one, _, three = PEERS.chain(1, 2, 3)
    refused(proof_of(one, three), "PROOF_INVALID")


def test_the_certificate_must_be_the_childs_and_a_quorums():
    one, two, three = PEERS.chain(1, 2, 3)
    refused(proof_of(one, two, PEERS.qc(three)), "PROOF_INVALID")
    refused(proof_of(one, two, PEERS.qc(one)), "PROOF_INVALID")
    of_the_same_round = PEERS.block(2, one, timestamp_ms=two.header.timestamp_ms + 1)
    refused(proof_of(one, two, PEERS.qc(of_the_same_round)), "PROOF_INVALID")
    one, two = PEERS.chain(1, 2)
    good = PEERS.qc(two)
    forged = IndexedSignature(index=2, signature=bytes(64))
    refused(proof_of(one, two, msgspec.structs.replace(good, votes=good.votes[:2])), "CERTIFICATE_INVALID")
    refused(proof_of(one, two, msgspec.structs.replace(good, votes=(*good.votes[:2], forged))), "CERTIFICATE_INVALID")
    one = PEERS.block(1)
    short = msgspec.structs.replace(PEERS.qc(one), votes=PEERS.qc(one).votes[:2])
    refused(proof_of(one, PEERS.block(2, one, qc=short)), "CERTIFICATE_INVALID")


def test_what_is_no_header_of_this_chain_and_epoch_is_refused():
    one, two = PEERS.chain(1, 2)
    with pytest.raises(BlockRobotError, match="another chain"):
        verify_finality(proof_of(one, two), PEERS.schedule, sha256(b"another"), GENESIS.block_id)
    other = PEERS.block(1, epoch=1)
    refused(proof_of(other, PEERS.block(2, other, qc=PEERS.qc(other))), "PROOF_OTHER_EPOCH")
    refused(proof_of(one, PEERS.block(2, one, epoch=1)), "PROOF_INVALID")
    one, two = PEERS.chain(1, 2)
    refused(msgspec.structs.replace(proof_of(one, two), header_bytes=b"\x90"), "ENCODING_INVALID")


# A client of a real genesis file

GENESIS_FILE = Genesis(
    version=1,
    network="ward",
    created_at_ms=1_800_000_000_000,
    settings=ChainSettings(),
    organisations=(),
    nodes=tuple(
        NodeEntry(
            name=f"n{number}",
            organisation="o",
            host="127.0.0.1",
            p2p_port=1,
            api_url="",
            producer_key=key.public_key,
            producer_possession=b"",
            custodian_key=b"",
        )
        for number, key in enumerate(PEERS.keys)
    ),
    contracts=(),
    purposes=(),
    state_root=sha256(b"genesis state"),
)


class Chain(Peers):
    """Blocks above the genesis file's own block."""

    def __init__(self):
        super().__init__()
        self.genesis = GENESIS_FILE.block()

    def qc(self, block, voters=None):
        if block.header.round == 0:
            return msgspec.structs.replace(super().qc(GENESIS), block_id=self.genesis.block_id)
        return msgspec.structs.replace(
            super().qc(block, voters),
            votes=tuple(
                IndexedSignature(index=index, signature=self.signed(index, block))
                for index in (voters or range(self.schedule.quorum))
            ),
        )

    def signed(self, index, block):
        header: Header = block.header
        return sign_vote(self.keys[index], GENESIS_FILE.chain_id, 0, header.round, block.block_id, index).signature

    def up_to(self, *rounds, state_root=None):
        blocks = [self.genesis]
        for number in rounds:
            changes = {"chain_id": GENESIS_FILE.chain_id}
            if state_root is not None:
                changes["state_root"] = state_root
            blocks.append(self.block(number, blocks[-1], qc=self.qc(blocks[-1]), **changes))
        return blocks

    def proof(self, block, child):
        return FinalityProof(
            header_bytes=block.header_bytes, child_header_bytes=child.header_bytes, child_qc=self.qc(child)
        )


def test_a_client_pins_what_it_verifies_and_the_same_header_proven_twice_is_fine():
    chain = Chain()
    _, one, two = chain.up_to(1, 2)
    client = LightClient(GENESIS_FILE)
    assert client.header == chain.genesis.header
    assert client.accept(chain.proof(one, two)) == one.header
    assert client.header_id == one.block_id
    client.accept(chain.proof(one, two))
    assert client.accept(chain.proof(one, two)) == one.header


def test_a_client_never_goes_back():
    chain = Chain()
    _, one, two, three = chain.up_to(1, 2, 3)
    client = LightClient(GENESIS_FILE)
    client.accept(chain.proof(two, three))
    with pytest.raises(BlockRobotError, match="PROOF_STALE") as caught:
        client.accept(chain.proof(one, two))
    assert caught.value.entry.retryable
    assert client.header == two.header


def test_a_contradicting_final_header_is_refused_even_if_a_quorum_signed_it():
    chain = Chain()
    _, one, two = chain.up_to(1, 2)
    _, other, end = chain.up_to(5, 6)
    client = LightClient(GENESIS_FILE)
    client.accept(chain.proof(one, two))
    with pytest.raises(BlockRobotError, match="contradicting"):
        client.accept(chain.proof(other, end))
    assert client.header == one.header


def test_a_client_goes_on_from_the_header_it_kept_if_it_is_of_this_chain():
    chain = Chain()
    _, one, two, three = chain.up_to(1, 2, 3)
    first = LightClient(GENESIS_FILE)
    first.accept(chain.proof(two, three))
    again = LightClient(GENESIS_FILE, first.pinned_header_bytes)
    with pytest.raises(BlockRobotError, match="PROOF_STALE"):
        again.accept(chain.proof(one, two))
    with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
        LightClient(GENESIS_FILE, GENESIS.header_bytes)


def test_a_value_and_an_absence_are_proven_against_the_final_state_root():
    key, value = b"records\x00record/1", encode_value({"status": "erased"})
    path = sha256(key)
    page = (1 << (path[0] >> 4)).to_bytes(2, "big") + b"\x00\x00" + path + hash_value(value)
    chain = Chain()
    _, one, two = chain.up_to(1, 2, state_root=hash_page(page))
    client, finality, pages = LightClient(GENESIS_FILE), chain.proof(one, two), Proof(pages=(page,))
    assert client.verify_state(finality, key, value, pages) == {"status": "erased"}
    absent = next(b"k%d" % n for n in range(99) if sha256(b"k%d" % n)[0] >> 4 != path[0] >> 4)
    assert client.verify_state(finality, absent, None, pages) is None
    with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
        client.verify_state(finality, key, encode_value({"status": "kept"}), pages)
    with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
        client.verify_state(finality, key, None, pages)


def test_a_proof_survives_the_wire():
    one, two = PEERS.chain(1, 2)
    proof = proof_of(one, two)
    assert verified(decode(encode(proof), FinalityProof)) == one.header
