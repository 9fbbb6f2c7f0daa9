"""R30, R31: whoever signs two different ids in one round is found out, whichever node looks and in whichever order."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.evidence import make_evidence, verify_evidence
from consensus.chain.messages import Proposal, Vote
from consensus.chain.signature_cache import SignatureCache
from consensus.errors import BlockRobotError
from consensus.limits import EVIDENCE_ROUNDS_KEPT_COUNT, MESSAGE_CHECKS_MAX_COUNT
from consensus.primitives.encoding import encode
from consensus.protocol.effects import EvidenceFound, SendTo
from consensus.protocol.events import ProposalReceived, VoteReceived
from tests.sim.named_chain import CHAIN_ID
from tests.unit.consensus.one_core import NOW_MS, TRANSACTION, OneCore, Peers, of_type

PEERS = Peers()
ONE, OTHER = PEERS.block(1), PEERS.block(1, transactions=(TRANSACTION,))


def hear(node, *words, sender=None):
    """Give the node votes and blocks, all from one sender; return the evidence that it finds."""
    found = []
    for word in words:
        if hasattr(word, "index"):
            event = VoteReceived(vote=word, now_ms=NOW_MS, sender=sender)
        else:
            event = ProposalReceived(proposal=Proposal(block=word), sender=sender, now_ms=NOW_MS)
        found += [effect.evidence for effect in of_type(node.handle(event), EvidenceFound)]
    return found


def evidence_of_votes(index=0):
    words = [(block.block_id, PEERS.vote(index, block).signature) for block in (ONE, OTHER)]
    return make_evidence("vote", 0, 1, PEERS.keys[index].public_key, *words)


def evidence_of_proposals():
    words = [(block.block_id, block.signature) for block in (ONE, OTHER)]
    return make_evidence("proposal", 0, 1, PEERS.keys[1].public_key, *words)


def test_two_words_of_one_round_are_evidence_though_only_the_first_counts():
    node = OneCore()
    assert hear(node, PEERS.vote(0, ONE), PEERS.vote(0, OTHER)) == [evidence_of_votes()]
    assert len(node.core._votes) == 1
    node = OneCore()
    assert hear(node, ONE, OTHER) == [evidence_of_proposals()]
    assert node.core.block(OTHER.block_id) is None


def test_evidence_is_the_same_bytes_on_every_node_in_whichever_order_it_came():
    """CVE-2021-21271: evidence that differs between nodes made a network disagree about a block that holds it."""
    there = hear(OneCore(3), PEERS.vote(0, ONE), PEERS.vote(0, OTHER)) + hear(OneCore(3), ONE, OTHER)
    here = hear(OneCore(2), PEERS.vote(0, OTHER), PEERS.vote(0, ONE)) + hear(OneCore(2), OTHER, ONE)
    assert [encode(evidence) for evidence in there] == [encode(evidence) for evidence in here]


def test_repeated_forged_or_unlike_words_are_no_evidence_and_a_pair_is_reported_once():
    node = OneCore()
    vote, other = PEERS.vote(0, ONE), PEERS.vote(0, OTHER)
    assert hear(node, vote, vote, ONE, ONE) == []
    assert len(hear(node, other, other, vote, PEERS.vote(0, PEERS.block(1, timestamp_ms=NOW_MS)))) == 1
    node = OneCore(2)
    later = PEERS.block(2, ONE)
    assert hear(node, ONE, PEERS.vote(1, OTHER), PEERS.vote(0, ONE), PEERS.vote(0, later)) == []
    node = OneCore()
    forged = msgspec.structs.replace(PEERS.vote(1, OTHER), index=0)
    assert hear(node, PEERS.vote(0, ONE), forged, msgspec.structs.replace(OTHER, signature=bytes(64))) == []
    # Its own words come back to it in certificates, and from whoever has its key.
    node = OneCore(0)
    assert hear(node, PEERS.vote(0, ONE), PEERS.vote(0, OTHER)) == []


def test_evidence_is_noticed_after_the_round_and_in_a_certificate_too():
    """The first one stands in a certificate only: this node never saw it alone."""
    node = OneCore()
    node.notice(PEERS.qc(ONE))
    assert hear(node, PEERS.vote(0, OTHER)) == [evidence_of_votes()]
    node = OneCore()
    hear(node, PEERS.vote(0, OTHER))
    found = [effect.evidence for effect in of_type(node.notice(PEERS.qc(ONE)), EvidenceFound)]
    assert found == [evidence_of_votes()]


def shown_to(node, *words):
    """To whom the node sends which block while it hears these words."""
    sent = []
    for word in words:
        if isinstance(word, Vote):
            event = VoteReceived(vote=word, now_ms=NOW_MS)
        else:
            event = ProposalReceived(proposal=Proposal(block=word), sender=None, now_ms=NOW_MS)
        sent += [
            (effect.index, effect.message.block.block_id)
            for effect in of_type(node.handle(event), SendTo)
            if isinstance(effect.message, Proposal)
        ]
    return sent


def test_who_voted_for_the_leaders_other_block_is_shown_this_one_once_and_a_forger_nothing():
    """R39: of seven, twins shown to three each are never certified; only so do both come before one pair of eyes."""
    vote = PEERS.vote(0, OTHER)
    assert shown_to(OneCore(), ONE, vote, vote, PEERS.vote(2, ONE)) == [(0, ONE.block_id)]
    assert shown_to(OneCore(), vote, ONE, ONE) == [(0, ONE.block_id)]
    assert shown_to(OneCore(), vote) == []
    forged = msgspec.structs.replace(PEERS.vote(0, OTHER), index=2)
    assert shown_to(OneCore(), ONE, forged) == []


def test_an_extra_signature_is_looked_at_no_more_than_so_often():
    """R31: a flood of forgeries of one producer and round costs a bounded number of checks."""
    checks = []

    class Counting(SignatureCache):
        def __call__(self, public_key, tag, signature, *parts):
            checks.append(signature)
            return super().__call__(public_key, tag, signature, *parts)

    node = OneCore()
    hear(node, PEERS.vote(0, ONE))
    node.core._message_log._check = Counting()
    for number in range(10 * MESSAGE_CHECKS_MAX_COUNT):
        hear(node, msgspec.structs.replace(PEERS.vote(0, OTHER), signature=bytes([number]) * 64))
    assert 0 < len(checks) <= MESSAGE_CHECKS_MAX_COUNT


def forged(word, count=10 * MESSAGE_CHECKS_MAX_COUNT):
    """Words of which no signature is genuine, each about another block."""
    if isinstance(word, Vote):
        return [msgspec.structs.replace(word, block_id=bytes([n]) * 32, signature=bytes(64)) for n in range(count)]
    blocks = [PEERS.block(1, timestamp_ms=NOW_MS + 1 + n) for n in range(count)]
    return [msgspec.structs.replace(block, signature=bytes(64)) for block in blocks]


@pytest.mark.parametrize("word", [PEERS.vote(0, ONE), ONE])
def test_forgeries_of_one_sender_hide_nothing_that_others_send(word):
    """R31: who sends rubbish, in his own name or another's, uses up what is looked at of himself only."""
    node = OneCore()
    other = PEERS.vote(0, OTHER) if isinstance(word, Vote) else OTHER
    for sender in (0, None):
        assert hear(node, *forged(word), sender=sender) == []
    found = hear(node, word, sender=1) + hear(node, other, sender=2)
    assert found == [evidence_of_votes() if isinstance(word, Vote) else evidence_of_proposals()]


def test_rubbish_hides_neither_a_second_vote_nor_a_second_block():
    """R30, R31: its vote counts here, so it was checked in any case: then it is remembered too."""
    node = OneCore()
    hear(node, *forged(PEERS.vote(0, ONE)), PEERS.vote(0, OTHER), sender=0)
    found = [effect.evidence for effect in of_type(node.notice(PEERS.qc(ONE)), EvidenceFound)]
    assert found == [evidence_of_votes()]
    node = OneCore()
    hear(node, *forged(ONE), ONE, sender=1)
    assert hear(node, OTHER, sender=2) == [evidence_of_proposals()]


def test_genuine_words_use_nothing_up_and_words_far_from_the_round_are_not_remembered():
    node = OneCore()
    for block in (ONE, *[PEERS.block(1, timestamp_ms=NOW_MS + 1 + n) for n in range(MESSAGE_CHECKS_MAX_COUNT)]):
        hear(node, PEERS.vote(0, block), sender=0)
    assert node.core._message_log._rounds[1]["vote", 0].failed_counts == {}
    node = OneCore()
    far = EVIDENCE_ROUNDS_KEPT_COUNT + 2
    words = [msgspec.structs.replace(PEERS.vote(0, block), round=far) for block in (ONE, OTHER)]
    assert hear(node, *words) == []
    assert far not in node.core._message_log._rounds


@pytest.mark.parametrize(
    "changes",
    [
        {"kind": "timeout"},
        {"round": 2},
        {"epoch": 1},
        {"round": -1},
        {"epoch": 1 << 32},
        {"first_id": OTHER.block_id, "second_id": OTHER.block_id},
        {"first_id": b""},
        {"first_signature": bytes(64)},
        {"second_signature": b""},
        {"producer": PEERS.keys[2].public_key},
        {"producer": b"nobody"},
    ],
)
def test_evidence_that_proves_nothing_is_refused(changes):
    good = evidence_of_votes()
    verify_evidence(good, CHAIN_ID)
    with pytest.raises(BlockRobotError, match="EVIDENCE_INVALID"):
        verify_evidence(msgspec.structs.replace(good, **changes), CHAIN_ID)
    with pytest.raises(BlockRobotError, match="EVIDENCE_INVALID"):
        verify_evidence(good, bytes(32))


def test_the_ids_of_evidence_stand_in_order():
    good = evidence_of_proposals()
    verify_evidence(good, CHAIN_ID)
    swapped = msgspec.structs.replace(
        good,
        first_id=good.second_id,
        second_id=good.first_id,
        first_signature=good.second_signature,
        second_signature=good.first_signature,
    )
    with pytest.raises(BlockRobotError, match="EVIDENCE_INVALID"):
        verify_evidence(swapped, CHAIN_ID)
