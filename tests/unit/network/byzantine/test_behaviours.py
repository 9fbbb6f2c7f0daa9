"""Each behaviour says what it promises, under the liar's genuine key, and the same again when asked again."""

from __future__ import annotations

from dataclasses import replace

import pytest

from consensus.chain.block import compute_receipts_root, compute_transactions_root
from consensus.chain.messages import (
    CertificateNotice,
    LastSignedResponse,
    Proposal,
    Timeout,
    Vote,
    is_valid_block_signature,
    is_valid_timeout_signature,
    is_valid_vote,
)
from consensus.chain.schedule import Schedule, verify_qc, verify_tc
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.protocol.effects import FetchBlocks, Message
from network.byzantine import BEHAVIOURS, ColludingNodes, byzantine_clock, check_behaviour
from network.byzantine.garbage import MESSAGES_PER_TICK_COUNT, RAW_EVERY_TICKS_COUNT
from tests.sim.named_chain import CHAIN_ID
from tests.unit.network.byzantine.liars import GENESIS, KEYS, LIAR, OTHERS, Own, liar, proposal, qc_of, timeout, vote

SCHEDULE = Schedule(0, tuple(key.public_key for key in KEYS))


def _is_genuine(message: Message) -> bool:
    """Whether the liar's own signature on a message is right: a lie without it would be no lie of his."""
    key = KEYS[LIAR].public_key
    if isinstance(message, Proposal):
        block, header = message.block, message.block.header
        return is_valid_block_signature(CHAIN_ID, header.epoch, header.round, block.block_id, block.signature, key)
    if isinstance(message, Vote):
        return is_valid_vote(message, CHAIN_ID, key)
    assert isinstance(message, Timeout)
    return is_valid_timeout_signature(message, CHAIN_ID, key)


def test_an_equivocator_shows_one_half_another_block_and_votes_for_each_where_it_showed_it() -> None:
    behaviour, kept = liar("equivocate")
    honest = proposal()
    behaviour.broadcast(honest)
    shown = {index: kept.seen_by(index)[0] for index in OTHERS}
    assert all(isinstance(message, Proposal) and _is_genuine(message) for message in shown.values())
    ids = {index: message.block.block_id for index, message in shown.items() if isinstance(message, Proposal)}
    assert len(set(ids.values())) == 2
    assert sorted([*ids.values()].count(block_id) for block_id in set(ids.values())) == [1, 2]
    twin = next(m for m in shown.values() if isinstance(m, Proposal) and m.block.block_id != honest.block.block_id)
    header = twin.block.header
    assert (header.round, header.parent_id, header.qc) == (5, GENESIS.block_id, honest.block.header.qc)
    assert header.state_root == GENESIS.header.state_root
    assert header.transactions_root == compute_transactions_root([])
    assert header.receipts_root == compute_receipts_root(())
    behaviour, kept = liar("equivocate")
    honest = proposal(transactions=0)
    for _ in range(2):
        behaviour.broadcast(honest)
        behaviour.broadcast(vote(honest.block.block_id))
    for index in OTHERS:
        first, ballot, *again = kept.seen_by(index)
        assert isinstance(first, Proposal)
        assert isinstance(ballot, Vote)
        assert ballot.block_id == first.block.block_id
        assert _is_genuine(ballot)
        assert again == [first, ballot]


def test_a_double_voter_tells_everybody_of_two_votes_and_prefers_an_accomplices_block() -> None:
    behaviour, kept = liar("double-vote")
    behaviour.broadcast(vote(b"a" * 32))
    behaviour.broadcast(vote(b"a" * 32))
    ballots = [message for message in kept.seen_by(0) if isinstance(message, Vote)]
    assert len(ballots) == 4
    assert len({ballot.block_id for ballot in ballots}) == 2
    assert all(_is_genuine(ballot) and ballot.round == 5 for ballot in ballots)
    ring = ColludingNodes()
    ring.tell(0, 5, b"b" * 32)
    behaviour, kept = liar("double-vote", ring=ring)
    behaviour.broadcast(vote(b"a" * 32))
    assert {m.block_id for m in kept.seen_by(0) if isinstance(m, Vote)} == {b"a" * 32, b"b" * 32}


def test_an_equivocator_tells_its_accomplices_of_both_blocks() -> None:
    ring = ColludingNodes()
    behaviour, _ = liar("equivocate", ring=ring)
    honest = proposal()
    behaviour.broadcast(honest)
    assert len(ring.rivals(0, 5, honest.block.block_id)) == 1


def test_who_withholds_votes_says_everything_else() -> None:
    behaviour, kept = liar("withhold-votes")
    words: list[Message] = [proposal(), timeout(5, qc_of(GENESIS.block_id, 0))]
    for message in [*words, vote(b"a" * 32)]:
        behaviour.broadcast(message)
        behaviour.send_to(0, message)
    assert [message for _, message in kept.sent] == [words[0], words[0], words[1], words[1]]


def test_who_withholds_blocks_votes_and_passes_on_the_blocks_of_others() -> None:
    behaviour, kept = liar("withhold-blocks", Own(index=2))
    foreign = proposal()
    behaviour.broadcast(foreign)
    behaviour, own = liar("withhold-blocks")
    behaviour.broadcast(foreign)
    behaviour.send_to(0, foreign)
    behaviour.broadcast(vote(foreign.block.block_id))
    assert kept.sent == [(None, foreign)]
    assert [type(message) for _, message in own.sent] == [Vote]


def test_partial_proposals_go_to_some_and_to_the_same_some_again() -> None:
    sizes = set()
    for seed in range(12):
        behaviour, kept = liar("partial-proposals", seed=seed)
        behaviour.broadcast(proposal())
        first = [receiver for receiver, _ in kept.sent]
        behaviour.broadcast(proposal())
        assert [receiver for receiver, _ in kept.sent] == first * 2
        assert set(first) < set(OTHERS)
        sizes.add(len(first))
    assert sizes == {1, 2}


def test_wrong_roots_are_signed_and_voted_for() -> None:
    fields = set()
    for seed in range(16):
        behaviour, kept = liar("wrong-roots", seed=seed)
        honest = proposal()
        behaviour.broadcast(honest)
        behaviour.broadcast(vote(honest.block.block_id))
        wrong, ballot = kept.seen_by(0)
        assert isinstance(wrong, Proposal)
        assert isinstance(ballot, Vote)
        assert _is_genuine(wrong)
        assert ballot.block_id == wrong.block.block_id
        header, truth = wrong.block.header, honest.block.header
        fields |= {name for name in header.__struct_fields__ if getattr(header, name) != getattr(truth, name)}
    assert fields == {"state_root", "receipts_root", "transactions_root", "gas_used"}


def test_stale_certificates_deny_what_is_newer_in_timeouts_blocks_and_notices() -> None:
    own = Own()
    behaviour, kept = liar("stale-certificates", own)
    chain = [proposal(round_number) for round_number in range(1, 9)]
    for number, item in enumerate(chain, start=1):
        own.round, own.high_qc = number + 1, qc_of(item.block.block_id, number)
        own.headers[item.block.block_id] = item.block.header
        behaviour.broadcast(timeout(number + 1, own.high_qc))
    said = [message for message in kept.seen_by(0) if isinstance(message, Timeout)]
    assert all(_is_genuine(message) for message in said)
    assert any(message.qc.round < message.round - 1 for message in said)
    behaviour.broadcast(timeout(9, own.high_qc))
    assert [m for m in kept.seen_by(0) if isinstance(m, Timeout)][-1] == said[-1]
    notices = [message for message in kept.seen_by(0) if isinstance(message, CertificateNotice)]
    behaviour.send_to(0, CertificateNotice(qc=own.high_qc, entered_by=None))
    notices.append(kept.sent[-1][1])  # type: ignore[arg-type]
    for notice in notices:
        assert notice.qc.round < own.high_qc.round
        verify_qc(notice.qc, SCHEDULE, CHAIN_ID, GENESIS.block_id)


def test_no_forged_certificate_passes_the_check_of_an_honest_node() -> None:
    forged = 0
    for seed in range(40):
        own = Own(high_qc=qc_of(b"c" * 32, 4))
        behaviour, kept = liar("forged-certificates", own, seed)
        for message in (proposal(), vote(b"a" * 32), timeout(5, own.high_qc)):
            behaviour.broadcast(message)
        for _, message in kept.sent:
            if isinstance(message, CertificateNotice):
                forged += 1
                with pytest.raises(BlockRobotError):
                    verify_qc(message.qc, SCHEDULE, CHAIN_ID, GENESIS.block_id)
                if message.entered_by is not None:
                    with pytest.raises(BlockRobotError):
                        verify_tc(message.entered_by, SCHEDULE, CHAIN_ID)
    assert forged == 80


@pytest.mark.parametrize("name", ["stale-certificates", "forged-certificates"])
def test_a_node_that_came_back_is_lied_to_about_what_it_said(name: str) -> None:
    own = Own(high_qc=qc_of(b"c" * 32, 4))
    behaviour, kept = liar(name, own)
    truth = LastSignedResponse(0, 7, "signing", 4, vote(b"a" * 32), own.high_qc, None)
    behaviour.send_to(0, truth)
    (answer,) = kept.seen_by(0)
    assert isinstance(answer, LastSignedResponse)
    assert answer.signed_round != truth.signed_round
    assert (answer.epoch, answer.asked_at_ms) == (0, 7)
    if name == "forged-certificates":
        with pytest.raises(BlockRobotError):
            verify_qc(answer.qc, SCHEDULE, CHAIN_ID, GENESIS.block_id)
    else:
        assert answer.message is None


def test_garbage_is_bounded_in_rate_and_never_ends_its_node() -> None:
    own = Own(high_qc=qc_of(b"c" * 32, 4))
    behaviour, kept = liar("garbage", own)
    for message in (proposal(), vote(b"a" * 32), timeout(5, own.high_qc)):
        behaviour.broadcast(message)
    for _ in range(10 * RAW_EVERY_TICKS_COUNT):
        behaviour.tick()
    assert len(kept.sent) == 3 + 10 * RAW_EVERY_TICKS_COUNT * MESSAGES_PER_TICK_COUNT
    assert len(own.raw) == 10
    assert {type(message) for _, message in kept.sent[3:]} == {
        Proposal,
        Vote,
        Timeout,
        CertificateNotice,
        LastSignedResponse,
    }
    assert all(encode(message) for _, message in kept.sent)


def test_a_clock_at_the_limit_is_ahead_by_what_the_chain_allows_and_others_are_right() -> None:
    assert byzantine_clock("time-limit", lambda: 100, 5_000)() == 5_100
    assert byzantine_clock("garbage+time-limit", lambda: 100, 5_000)() == 5_100
    assert byzantine_clock("equivocate", lambda: 100, 5_000)() == 100


@pytest.mark.parametrize("name", sorted(BEHAVIOURS))
def test_every_behaviour_replays_from_its_seed_and_lets_fetches_and_gossip_through(name: str) -> None:
    def history(seed: int) -> list[tuple[int | None, Message]]:
        own = Own(high_qc=qc_of(b"c" * 32, 4))
        behaviour, kept = liar(name, own, seed)
        for message in (proposal(), vote(proposal().block.block_id), timeout(5, own.high_qc)):
            behaviour.broadcast(message)
            behaviour.tick()
        fetch = FetchBlocks(block_id=b"f" * 32, above_height=0, producers=(0,))
        behaviour.fetch(fetch)
        behaviour.gossip_again()
        assert (kept.fetched, kept.gossiped) == ([fetch], 1)
        return kept.sent

    assert history(3) == history(3)


def test_behaviours_are_joined_and_each_of_them_acts() -> None:
    behaviour, kept = liar("equivocate+garbage")
    honest = proposal()
    behaviour.broadcast(honest)
    behaviour.tick()
    assert len(kept.sent) == len(OTHERS) + MESSAGES_PER_TICK_COUNT


@pytest.mark.parametrize("name", ["", "honest", "equivocate+", "garbage+garbage", "Equivocate"])
def test_a_wrong_name_is_refused(name: str) -> None:
    with pytest.raises(BlockRobotError, match=r"^FAULT_UNKNOWN:"):
        check_behaviour(name)


def test_a_liar_about_epochs_signs_for_others_than_it_is_in_and_shows_certificates_of_before() -> None:
    own = Own(epoch=3, high_qc=qc_of(b"c" * 32, 4))
    behaviour, kept = liar("wrong-epochs", own)
    behaviour.broadcast(timeout(5, own.high_qc))
    own.index = None
    for _ in range(200):
        behaviour.tick()
    said = [message for _, message in kept.sent]
    votes = [message for message in said if isinstance(message, Vote)]
    assert {2, 4, 5} <= {message.epoch for message in votes}
    assert 3 not in {message.epoch for message in votes}
    assert all(_is_genuine(message) and message.index == LIAR for message in votes)
    relabelled = [message.qc for message in said if isinstance(message, CertificateNotice) and message.qc.epoch == 3]
    assert relabelled
    for qc in relabelled:
        with pytest.raises(BlockRobotError):
            verify_qc(qc, replace(SCHEDULE, epoch=3), CHAIN_ID, GENESIS.block_id)
    assert {type(message) for message in said} >= {Vote, Timeout, CertificateNotice, LastSignedResponse}
    assert own.raw
