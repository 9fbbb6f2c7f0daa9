"""R6, R7: giving rounds up, and getting into the next one."""

from __future__ import annotations

import pytest

from consensus.chain.block import QuorumCertificate
from consensus.chain.messages import CertificateNotice, Proposal, Timeout, Vote
from consensus.protocol.effects import TIMER_RESEND, TIMER_ROUND, Broadcast, BuildBlock, CancelTimer, Persist, SetTimer
from consensus.protocol.events import PeerConnected, TimeoutReceived, VoteReceived
from tests.unit.consensus.one_core import NOW_MS, OneCore, of_type, said, told


def given_up(node):
    node.work()
    return node.fire(TIMER_ROUND)


def test_a_timer_that_runs_out_is_journalled_and_told_once_and_an_older_one_says_nothing():
    node = OneCore()
    effects = given_up(node)
    assert isinstance(effects[0], Persist)
    assert effects[1] == Broadcast(node.timeout(3, 1))
    assert node.core.has_timed_out
    node = OneCore()
    node.work()
    node.notice(node.core.high_qc, node.tc(1))
    assert said(node.fire(TIMER_ROUND, 1), Timeout) == []
    node = OneCore()
    given_up(node)
    assert said(node.fire(TIMER_ROUND), Timeout) == []


def test_a_timeout_is_sent_again_every_base_interval_byte_for_byte_until_the_round_ends():
    node = OneCore()
    first = given_up(node)
    assert SetTimer(kind=TIMER_RESEND, round=1, delay_ms=500) in first
    again = node.fire(TIMER_RESEND)
    assert said(again, Timeout) == said(first, Timeout)
    assert of_type(again, Persist) == []
    assert SetTimer(kind=TIMER_RESEND, round=1, delay_ms=500) in again
    node = OneCore()
    given_up(node)
    effects = node.notice(node.core.high_qc, node.tc(1))
    assert CancelTimer(kind=TIMER_RESEND) in effects
    assert said(node.fire(TIMER_RESEND, 1), Timeout) == []


def test_two_timeouts_of_different_producers_make_a_node_join_and_a_quorum_leads_on():
    """f+1 = 2 of 4: at least one of them is honest."""
    node = OneCore()
    assert said(node.timeout_from(0, 1), Timeout) == []
    assert said(node.timeout_from(1, 1), Timeout) == [node.timeout(3, 1)]
    node = OneCore()
    node.timeout_from(0, 1)
    assert said(node.timeout_from(0, 1), Timeout) == []
    assert node.core.round == 1
    node = OneCore()
    node.timeout_from(0, 1)
    node.timeout_from(1, 1)
    assert node.core.round == 2
    assert node.core.entered_by == node.tc(1, signers=(0, 1, 3))


def test_a_timeout_of_a_later_round_counts_by_its_genuine_certificates_alone():
    node = OneCore()
    node.timeout_from(0, 5, node.core.high_qc, node.tc(4))
    assert node.core.round == 5
    node = OneCore()
    for index in (0, 1, 2):
        assert said(node.timeout_from(index, 5), Timeout) == []
    assert node.core.round == 1
    node = OneCore()
    for index in (0, 1, 2):
        forged = Timeout(epoch=0, round=1, index=index, signature=bytes(64), qc=node.core.high_qc, entered_by=None)
        node.handle(TimeoutReceived(timeout=forged, sender=index, now_ms=NOW_MS))
    assert node.core.round == 1
    assert not node.core.has_timed_out


@pytest.mark.parametrize(("epoch", "index", "qc_round"), [(1, 0, 0), (0, 4, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1)])
def test_a_timeout_with_impossible_numbers_is_ignored(epoch, index, qc_round):
    node = OneCore()
    qc = QuorumCertificate(epoch=0, round=qc_round, block_id=bytes(32), votes=())
    timeout = Timeout(epoch=epoch, round=1, index=index, signature=bytes(64), qc=qc, entered_by=None)
    assert node.handle(TimeoutReceived(timeout=timeout, sender=0, now_ms=NOW_MS)) == []


def test_a_timeout_with_a_certificate_of_its_own_round_is_ignored_though_all_is_genuine():
    """Who has it is in the next round already; nobody takes such a timeout in a TC."""
    node = OneCore()
    timeout = node.timeout(0, 1, node.qc(node.block(1)))
    assert node.handle(TimeoutReceived(timeout=timeout, sender=0, now_ms=NOW_MS)) == []
    assert node.core.round == 1


def test_a_timeout_that_names_a_qc_it_does_not_have_counts_for_nothing():
    """Otherwise a TC could name a QC that no leader can show."""
    node = OneCore()
    invented = QuorumCertificate(epoch=0, round=6, block_id=bytes(32), votes=())
    node.notice(node.core.high_qc, node.tc(6))
    before = node.core.high_qc
    for index in (0, 1):
        node.timeout_from(index, 7, invented, node.tc(6))
    assert node.core.high_qc == before
    assert not node.core.has_timed_out


def test_what_comes_late_is_answered_with_the_highest_certificates():
    node = OneCore()
    node.notice(node.core.high_qc, node.tc(1))
    answer = CertificateNotice(qc=node.core.high_qc, entered_by=node.tc(1))
    for _ in range(2):
        assert told(node.timeout_from(0, 1), 0, CertificateNotice) == [answer]
    node = OneCore()
    node.notice(node.core.high_qc, node.tc(4))
    assert len(told(node.receive(node.block(1), sender=1), 1, CertificateNotice)) == 1


def test_the_last_vote_of_a_round_is_answered_once_it_is_long_lost_and_not_before():
    node = OneCore()
    one = node.block(1)
    chain = node.chain(1, 2, 3, 4)
    for block in chain:
        node.receive(block)
    node.notice(node.qc(chain[-1]))
    late = VoteReceived(vote=node.vote(0, one), now_ms=NOW_MS)
    assert len(told(node.handle(late), 0, CertificateNotice)) == 1
    assert told(node.handle(late), 0, CertificateNotice) == []
    node = OneCore()
    one = node.block(1)
    node.receive(one)
    node.vote_from(0, one)
    node.vote_from(1, one)
    assert node.core.round == 2
    assert node.vote_from(2, one) == []


def test_a_tc_that_is_forged_or_names_an_unknown_qc_does_not_lead_on():
    """R7: this node could not lead the next round: it has no QC that satisfies the TC."""
    node = OneCore()
    one = node.block(1)
    node.notice(node.core.high_qc, node.tc(2, 1))
    assert node.core.round == 1
    node.notice(node.qc(one), node.tc(2, 1))
    assert node.core.round == 3
    node = OneCore()
    node.notice(node.core.high_qc, node.tc(3, signers=(0, 1)))
    assert node.core.round == 1


def test_a_peer_that_connects_gets_certificates_proposal_vote_and_timeout():
    node = OneCore(1)

    (order,) = of_type(node.work(), BuildBlock)
    node.built(order)
    node.fire(TIMER_ROUND)
    effects = node.handle(PeerConnected(index=0, now_ms=NOW_MS))
    for kind in (CertificateNotice, Proposal, Vote, Timeout):
        assert len(told(effects, 0, kind)) == 1


def test_a_follower_gives_nothing_up():
    node = OneCore(None)
    node.work()
    assert said(node.fire(TIMER_ROUND), Timeout) == []
    for index in (0, 1, 2):
        node.timeout_from(index, 1)
    assert node.core.round == 2


def test_a_round_that_its_leader_gave_up_is_given_up_at_once_unless_its_block_is_known():
    """R6: its block will not come. Another producer's timeout alone moves nobody."""
    node = OneCore(3)
    node.work()
    assert said(node.timeout_from(2, 1), Timeout) == []
    assert [word.round for word in said(node.timeout_from(1, 1), Timeout)] == [1]
    node = OneCore(3)
    node.receive(node.block(1))
    assert said(node.timeout_from(1, 1), Timeout) == []
