"""R30, R33: evidence is found just when two genuine messages differ; who came back never speaks below what peers hold."""

from __future__ import annotations

from itertools import combinations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from consensus.chain.evidence import verify_evidence
from consensus.chain.messages import Proposal, SignedMessage, Timeout, Vote
from consensus.protocol.effects import EvidenceFound
from consensus.protocol.events import ProposalReceived, VoteReceived
from tests.sim.named_chain import CHAIN_ID, make_transaction
from tests.unit.consensus.one_core import NOW_MS, OneCore, Peers, of_type, said

PEERS = Peers()
BLOCKS = [
    PEERS.block(number, tc=PEERS.tc(number - 1) if number > 1 else None, transactions=(make_transaction(kind),))
    for number in (1, 2, 4)
    for kind in range(3)
]
"""Three each of rounds that this node does not lead, all on genesis: their certificates hold no votes."""
OWN = 3

genuine_votes = st.builds(PEERS.vote, st.integers(0, 2), st.sampled_from(BLOCKS))
forged_votes = st.builds(
    lambda vote, index, signature: msgspec.structs.replace(vote, index=index, signature=signature or vote.signature),
    genuine_votes,
    st.integers(0, 2),
    st.one_of(st.just(b""), st.binary(min_size=64, max_size=64)),
)
messages = st.one_of(genuine_votes, forged_votes, st.sampled_from(BLOCKS))


def place_of(message):
    """Return (kind, round, producer index, id) of a genuine message, None for a forged one."""
    if isinstance(message, Vote):
        block = next(block for block in BLOCKS if block.block_id == message.block_id)
        return (
            ("vote", message.round, message.index, message.block_id)
            if message == PEERS.vote(message.index, block)
            else None
        )
    return "proposal", message.header.round, message.header.producer, message.block_id


@given(st.lists(messages, max_size=12))
def test_evidence_is_found_just_when_two_genuine_words_of_one_place_differ(script):
    node = OneCore(OWN)
    found = []
    for message in script:
        if isinstance(message, Vote):
            event = VoteReceived(vote=message, now_ms=NOW_MS)
        else:
            event = ProposalReceived(proposal=Proposal(block=message), sender=None, now_ms=NOW_MS)
        found += [effect.evidence for effect in of_type(node.executed(node.handle(event)), EvidenceFound)]
    places = {place for place in map(place_of, script) if place is not None}
    guilty = {first[:3] for first, second in combinations(places, 2) if first[:3] == second[:3]}
    for evidence in found:
        verify_evidence(evidence, CHAIN_ID)
    named = [(evidence.kind, evidence.round, PEERS.schedule.index_of(evidence.producer)) for evidence in found]
    assert len(named) == len(set(named))
    assert set(named) == guilty


held_messages = st.one_of(
    st.none(),
    st.sampled_from([block for block in BLOCKS if block.header.producer != OWN]).map(
        lambda block: SignedMessage("vote", 0, block.header.round, block.block_id, 0, PEERS.vote(OWN, block).signature)
    ),
    st.integers(1, 5).map(
        lambda number: SignedMessage("timeout", 0, number, b"", 0, PEERS.timeout(OWN, number).signature)
    ),
)
steps = st.one_of(
    st.tuples(st.just("block"), st.sampled_from(BLOCKS)),
    st.tuples(st.just("timeout"), st.just(None)),
    st.tuples(st.just("answer"), st.tuples(st.integers(0, 2), held_messages, st.integers(0, 1))),
    st.tuples(st.just("restart"), st.booleans()),
)


@given(st.lists(st.tuples(st.integers(0, 2), held_messages), max_size=3), st.lists(steps, max_size=15))
def test_a_producer_never_speaks_at_or_below_a_round_in_which_peers_hold_a_word_that_it_forgot(first, script):
    """Whatever it was told before it spoke, in whichever life, binds it."""
    node = OneCore(OWN, answered=False)
    node.work()
    told: set[int] = set()
    spoke: dict[int, set[str]] = {}
    answers = [("answer", (peer, message, 0)) for peer, message in first]
    for kind, what in [*answers, *script]:
        if kind == "block":
            effects = node.receive(what)
        elif kind == "timeout":
            effects = node.fire("round")
        elif kind == "answer":
            peer, message, signed_round = what
            if message is not None and not node.core._voter.remembers(message) and node.core.lockout is not None:
                told.add(message.round)
            effects = node.answer_from(peer, message=message, signed_round=signed_round)
        else:
            journal = list(node.core.journal_snapshot()) if what else node.journal
            node = OneCore(OWN, journal=journal, answered=False)
            effects = [*node.work()]
        for message in [*said(effects, Vote), *said(effects, Timeout)]:
            messages_of_round = spoke.setdefault(message.round, set())
            messages_of_round.add("timeout" if isinstance(message, Timeout) else message.block_id.hex())
            assert all(message.round > number for number in told), (message, told)
    assert all(len(messages_of_round - {"timeout"}) <= 1 for messages_of_round in spoke.values())
