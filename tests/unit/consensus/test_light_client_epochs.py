"""R22, R26: a client that trusts only the genesis file follows the chain from epoch to epoch."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.block import EpochProof, FinalityProof, certificate_of
from consensus.chain.light_client import LightClient
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from tests.unit.consensus.many_epochs import GENESIS_FILE, ManyEpochs, make_epoch, renamed


def refused(action, code, words=None):
    with pytest.raises(BlockRobotError, match=words) as caught:
        action()
    assert caught.value.code == code
    return caught.value


def test_a_client_follows_the_epochs_one_by_one():
    chain = ManyEpochs()
    client = LightClient(GENESIS_FILE)
    for first_key in (3, 6, 0):
        chain.grow(2)
        proof = chain.change(first_key)
        assert client.advance(proof) == proof.epoch
        assert client.header == chain.blocks[-1].header
        block = chain.grow()
        assert client.accept(chain.prove(block)) == block.header
    assert client.epoch.number == 3
    assert len(client.epochs) == 3


def test_a_header_of_a_later_epoch_waits_and_one_of_an_epoch_that_is_over_is_stale():
    chain = ManyEpochs()
    proof = chain.change(4)
    later = chain.prove(chain.grow())
    client = LightClient(GENESIS_FILE)
    error = refused(lambda: client.accept(later), "PROOF_OTHER_EPOCH")
    assert error.entry.retryable
    client.advance(proof)
    assert client.accept(later) == chain.blocks[-1].header
    chain = ManyEpochs()
    old = chain.prove(chain.grow())
    client = LightClient(GENESIS_FILE, epochs=[chain.change(4)])
    assert refused(lambda: client.accept(old), "PROOF_STALE").entry.retryable


def test_an_epoch_cannot_be_skipped_and_one_that_was_entered_before_changes_nothing():
    chain = ManyEpochs()
    proofs = [chain.change(1), chain.change(2)]
    client = LightClient(GENESIS_FILE)
    refused(lambda: client.advance(proofs[1]), "PROOF_OTHER_EPOCH")
    assert [client.advance(proof).number for proof in proofs] == [1, 2]
    chain = ManyEpochs()
    proofs = [chain.change(1), chain.change(2)]
    client = LightClient(GENESIS_FILE, epochs=proofs)
    assert client.advance(proofs[0]).number == 2
    assert client.epochs == tuple(proofs)


def test_another_epoch_of_a_number_that_was_entered_before_is_refused_and_not_passed_over():
    """Who keeps what `advance` let pass would else keep an epoch that nobody decided."""
    chain = ManyEpochs()
    proofs = [chain.change(1), chain.change(2)]
    client = LightClient(GENESIS_FILE, epochs=proofs)
    for number in (-1, 0, 1, 2):
        mine = renamed(proofs[1], number=number, producers=proofs[0].epoch.producers[:1])
        refused(lambda mine=mine: client.advance(mine), "PROOF_INVALID", "another epoch")
    by_another_boundary = msgspec.structs.replace(proofs[1], finality=proofs[0].finality)
    refused(lambda: client.advance(by_another_boundary), "PROOF_INVALID", "another epoch")
    assert client.epochs == tuple(proofs)


def test_the_boundary_itself_is_believed_in_both_epochs():
    """After a change on an idle network the boundary is the newest block, and its proof is of the epoch before."""
    chain = ManyEpochs()
    chain.grow()
    proof = chain.change(4)
    client = LightClient(GENESIS_FILE)
    assert client.accept(proof.finality) == chain.blocks[-1].header
    client.advance(proof)
    assert client.accept(proof.finality) == chain.blocks[-1].header


def test_removed_producers_prove_nothing_in_the_next_epoch():
    chain = ManyEpochs()
    proof = chain.change(4)
    client = LightClient(GENESIS_FILE, epochs=[proof])
    old = ManyEpochs()
    old.peers.epoch, old.peers.root = 1, chain.blocks[-1]
    old.peers.root_qc = chain.peers.root_qc
    old.blocks = [chain.blocks[-1]]
    refused(lambda: client.accept(old.prove(old.grow())), "CERTIFICATE_INVALID")


@pytest.mark.parametrize(
    "changes",
    [
        {"producers": make_epoch(1, 5).producers},
        {"leaderless": (1,)},
        {"settings": msgspec.structs.replace(make_epoch(1).settings, base_timeout_ms=1)},
    ],
    ids=str,
)
def test_the_boundary_names_the_epoch_and_no_other(changes):
    proof = ManyEpochs().change(4)
    client = LightClient(GENESIS_FILE)
    refused(lambda: client.advance(renamed(proof, **changes)), "PROOF_INVALID", "another next epoch")
    assert client.epoch.number == 0


def test_an_epoch_begins_with_a_boundary_whose_last_two_rounds_follow_each_other():
    chain = ManyEpochs()
    proof = EpochProof(finality=chain.prove(chain.grow()), epoch=make_epoch(1, 4))
    refused(lambda: LightClient(GENESIS_FILE).advance(proof), "PROOF_INVALID", "another next epoch")
    proof = ManyEpochs().change(4, through=(2, 4))
    refused(lambda: LightClient(GENESIS_FILE).advance(proof), "PROOF_INVALID", "next round")


# Proofs through closing blocks


def test_a_boundary_is_proven_through_closing_blocks():
    chain = ManyEpochs()
    chain.grow(2)
    proof = chain.change(4, through=(2, 4, 5))
    assert len(proof.finality.through) == 2
    client = LightClient(GENESIS_FILE)
    client.advance(proof)
    assert client.header == chain.blocks[-1].header
    assert certificate_of(proof.finality).block_id == chain.blocks[-1].block_id


def test_nothing_but_a_boundary_is_proven_through_others():
    chain = ManyEpochs()
    one, two, three = chain.grow(), chain.grow(), chain.grow()
    proof = FinalityProof(
        header_bytes=one.header_bytes,
        child_header_bytes=three.header_bytes,
        child_qc=chain.peers.qc(three),
        through=(two.header_bytes,),
    )
    refused(lambda: LightClient(GENESIS_FILE).accept(proof), "PROOF_INVALID", "Only a boundary")


def test_a_closing_block_is_never_final():
    chain = ManyEpochs()
    peers = chain.peers
    chain.change(4, through=(1, 2))
    boundary = chain.blocks[-1]
    closing = peers.closing(2, boundary)
    after = peers.closing(3, closing)
    proof = FinalityProof(
        header_bytes=closing.header_bytes, child_header_bytes=after.header_bytes, child_qc=peers.qc(after)
    )
    refused(lambda: LightClient(GENESIS_FILE).accept(proof), "PROOF_INVALID", "never final")


@pytest.mark.parametrize("place", [0, 1])
def test_every_closing_block_of_the_proof_must_be_there(place):
    proof = ManyEpochs().change(4, through=(2, 4, 5))
    through = tuple(header for index, header in enumerate(proof.finality.through) if index != place)
    broken = msgspec.structs.replace(proof, finality=msgspec.structs.replace(proof.finality, through=through))
    refused(lambda: LightClient(GENESIS_FILE).advance(broken), "PROOF_INVALID")


def test_every_certificate_of_the_proof_must_be_a_quorums():
    chain = ManyEpochs()
    peers = chain.peers
    good = chain.change(4)
    boundary = chain.blocks[-1]
    qc = peers.qc(boundary)
    closing = peers.closing(2, boundary, qc=msgspec.structs.replace(qc, votes=qc.votes[:2]))
    finality = msgspec.structs.replace(
        good.finality, child_header_bytes=closing.header_bytes, child_qc=peers.qc(closing)
    )
    broken = msgspec.structs.replace(good, finality=finality)
    refused(lambda: LightClient(GENESIS_FILE).advance(broken), "CERTIFICATE_INVALID")


# What is kept between runs


def test_a_client_goes_on_from_what_it_kept():
    chain = ManyEpochs()
    first = LightClient(GENESIS_FILE)
    first.advance(chain.change(4))
    first.accept(chain.prove(chain.grow()))
    kept = [decode(encode(proof), EpochProof) for proof in first.epochs]
    again = LightClient(GENESIS_FILE, first.pinned_header_bytes, kept)
    assert (again.header, again.epoch) == (first.header, first.epoch)
    block = chain.grow()
    assert again.accept(chain.prove(block)) == block.header


def test_a_client_that_kept_only_its_header_fetches_the_epochs_again_and_still_never_goes_back():
    chain = ManyEpochs()
    proofs = [chain.change(4), chain.change(2)]
    old, new = chain.grow(), chain.grow()
    first = LightClient(GENESIS_FILE, epochs=proofs)
    first.accept(chain.prove(new))
    again = LightClient(GENESIS_FILE, first.pinned_header_bytes)
    refused(lambda: again.accept(chain.prove(new)), "PROOF_OTHER_EPOCH")
    for proof in proofs:
        again.advance(proof)
    assert again.header == new.header
    refused(lambda: again.accept(chain.prove(old)), "PROOF_STALE")
    assert again.accept(chain.prove(new)) == new.header


def test_another_boundary_or_a_second_chain_of_the_next_epoch_is_a_contradiction():
    """The producers sign two histories: one with a boundary, and one in which the epoch went on above it."""
    chain, forked = ManyEpochs(), ManyEpochs()
    chain.grow(3)
    client = LightClient(GENESIS_FILE)
    client.accept(chain.prove(chain.blocks[-1]))
    refused(lambda: client.advance(forked.change(4)), "PROOF_INVALID", "more producers are faulty")
    assert client.epoch.number == 0
    chain, forked = ManyEpochs(), ManyEpochs()
    client = LightClient(GENESIS_FILE, epochs=[chain.change(4)])
    chain.grow(2)
    client.accept(chain.prove(chain.blocks[-1]))
    forked.change(4)
    forked.grow()
    other = forked.peers.block(9, forked.blocks[-1], tc=forked.peers.tc(8, 1))
    assert other.header.height == client.header.height
    refused(lambda: client.accept(forked.prove(other)), "PROOF_INVALID", "contradicting")
