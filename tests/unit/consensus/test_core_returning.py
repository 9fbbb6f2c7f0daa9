"""R33 to R36: a producer signs nothing before it has heard what it said last, and is silent after it forgot something."""

from __future__ import annotations

import pytest

from consensus.chain.journal_records import (
    JournalRecord,
    SigningLockout,
    encode_lockout_record,
    encode_restored_record,
    read_journal,
)
from consensus.chain.messages import (
    ASKING,
    LOCKED_OUT,
    SIGNING,
    LastSignedRequest,
    LastSignedResponse,
    Proposal,
    SignedMessage,
    Timeout,
    Vote,
)
from consensus.chain.schedule import Schedule
from consensus.primitives.encoding import decode
from consensus.protocol.core import Core
from consensus.protocol.effects import TIMER_ASK, Broadcast, CancelTimer, LockoutChanged, Persist, SendTo, SetTimer
from consensus.protocol.events import LastSignedReceived, LastSignedRequested, PeerConnected, Started
from tests.sim.named_chain import CHAIN_ID
from tests.unit.consensus.one_core import CHECK, GENESIS_QC, NOW_MS, TRANSACTION, OneCore, Peers, of_type, said, told

PEERS = Peers()
ONE, OTHER = PEERS.block(1), PEERS.block(1, transactions=(TRANSACTION,))
RESTORED = encode_restored_record()


def vote_word(block, index=3, keys=PEERS):
    vote = keys.vote(index, block)
    header = block.header
    return SignedMessage("vote", header.epoch, header.round, vote.block_id, 0, vote.signature)


def timeout_word(round_number, index=3):
    return SignedMessage("timeout", 0, round_number, b"", 0, PEERS.timeout(index, round_number).signature)


def finalize(node, first, last):
    """Let the others finalize blocks of these rounds without this node (of 7: it leads none of the first six)."""
    effects = []
    for block in node.chain(*range(first, last + 1)):
        effects += node.receive(block)
        effects += node.notice(node.qc(block))
    return effects


# Asking


def test_nothing_is_signed_before_a_quorum_less_one_has_answered():
    node = OneCore(answered=False)
    assert said(node.receive(ONE), Vote) == []
    node.work()
    assert said(node.fire("round"), Timeout) == []
    assert said(node.answer_from(0), Vote) == []
    assert said(node.answer_from(0), Vote) == []
    assert node.core.lockout.reason == ASKING
    assert said(node.answer_from(1), Vote) == [node.vote(3, ONE)]
    assert node.core.lockout is None


def test_a_leader_that_asks_proposes_only_when_it_may_speak():
    node = OneCore(1, answered=False)
    assert "BuildBlock" not in {type(effect).__name__ for effect in node.work()}
    node.answer_from(0)
    assert "BuildBlock" in {type(effect).__name__ for effect in node.answer_from(2)}


def test_a_producer_asks_at_its_start_again_every_interval_and_whoever_connects_until_it_is_answered():
    node = OneCore(answered=False)
    assert said(node.started, LastSignedRequest) == [LastSignedRequest(epoch=0, asked_at_ms=NOW_MS)]
    assert of_type(node.started, SetTimer)[-1].kind == TIMER_ASK
    assert len(said(node.fire(TIMER_ASK), LastSignedRequest)) == 1
    assert len(told(node.handle(PeerConnected(index=0, now_ms=NOW_MS)), 0, LastSignedRequest)) == 1
    node.answer_from(0)
    assert CancelTimer(kind=TIMER_ASK) in node.answer_from(2)
    assert said(node.fire(TIMER_ASK), LastSignedRequest) == []
    assert told(node.handle(PeerConnected(index=1, now_ms=NOW_MS)), 1, LastSignedRequest) == []


@pytest.mark.parametrize("node", [OneCore(0, count=1), OneCore(None, answered=False)])
def test_a_lone_producer_and_a_follower_ask_nobody(node):
    assert said(node.started, LastSignedRequest) == []
    assert node.core.lockout is None


def test_an_answer_counts_only_from_a_producer_to_what_was_asked_in_this_life_and_with_proven_rounds():
    node = OneCore(answered=False)
    good = LastSignedResponse(0, NOW_MS, SIGNING, 0, None, GENESIS_QC, None)
    for answer, sender in [
        (good, None),
        (good, 9),
        (good, 3),
        (LastSignedResponse(0, NOW_MS - 1, SIGNING, 0, None, GENESIS_QC, None), 0),
        (LastSignedResponse(1, NOW_MS, SIGNING, 0, None, GENESIS_QC, None), 0),
        (LastSignedResponse(0, NOW_MS, SIGNING, 2, None, GENESIS_QC, None), 0),
        (LastSignedResponse(0, NOW_MS, SIGNING, -1, None, GENESIS_QC, None), 0),
        (LastSignedResponse(0, NOW_MS, SIGNING, 0, None, PEERS.qc(ONE, (0, 1)), None), 0),
    ]:
        node.handle(LastSignedReceived(answer=answer, sender=sender, now_ms=NOW_MS))
    assert node.core._voter.signing_guard._willing == set()
    node.handle(LastSignedReceived(answer=good, sender=0, now_ms=NOW_MS))
    assert node.core._voter.signing_guard._willing == {0}


def test_answers_of_silent_producers_do_not_count_but_bring_certificates():
    node = OneCore(answered=False)
    for peer in (0, 1):
        node.answer_from(peer, signing_state=LOCKED_OUT)
    assert node.core.lockout is not None
    node.answer_from(2)
    node.answer_from(1, signing_state=ASKING)
    assert node.core.lockout is None
    node = OneCore(answered=False)
    node.answer_from(0, qc=PEERS.qc(ONE), entered_by=node.tc(4, 1), signed_round=5)
    assert (node.core.round, node.core.high_qc) == (5, PEERS.qc(ONE))


# Answering


def test_a_producer_tells_another_one_the_newest_word_that_it_heard_of_it():
    node = OneCore(0)
    for block in node.chain(1, 2):
        node.vote_from(3, block)
    node.timeout_from(2, 1)
    request = LastSignedRequest(epoch=0, asked_at_ms=5)
    for asker, message in [(3, ("vote", 2)), (2, ("timeout", 1)), (1, None)]:
        (answer,) = told(
            node.handle(LastSignedRequested(request=request, sender=asker, now_ms=NOW_MS)), asker, LastSignedResponse
        )
        assert (answer.asked_at_ms, answer.signing_state, answer.qc) == (5, SIGNING, node.core.high_qc)
        assert (None if answer.message is None else (answer.message.kind, answer.message.round)) == message


def test_a_word_is_remembered_out_of_certificates_and_over_a_restart():
    node = OneCore(0, count=7)
    one, two = node.chain(1, 2)
    node.receive(one)
    node.receive(two)
    after = node.restarted()
    request = LastSignedRequest(epoch=0, asked_at_ms=5)
    (answer,) = told(after.handle(LastSignedRequested(request=request, sender=3, now_ms=NOW_MS)), 3, LastSignedResponse)
    assert (answer.message.kind, answer.message.round) == ("vote", 1)
    (answer,) = told(after.handle(LastSignedRequested(request=request, sender=2, now_ms=NOW_MS)), 2, LastSignedResponse)
    assert (answer.message.kind, answer.message.round) == ("proposal", 2)


def test_nobody_is_told_about_anybody_else_nor_in_another_epoch():
    node = OneCore(0)
    before = node.handle(
        LastSignedRequested(request=LastSignedRequest(epoch=1, asked_at_ms=5), sender=3, now_ms=NOW_MS)
    )
    unknown = node.handle(
        LastSignedRequested(request=LastSignedRequest(epoch=0, asked_at_ms=5), sender=None, now_ms=NOW_MS)
    )
    assert of_type(before + unknown, SendTo) == []


# Lockout


def test_an_old_journal_forgets_a_word_that_the_others_hold():
    """What the rule is for: the journal was put back from before the vote, and nobody tells."""
    node = OneCore()
    assert said(node.receive(ONE), Vote) == [node.vote(3, ONE)]
    forgetful = OneCore(journal=[])
    assert said(forgetful.receive(OTHER), Vote) == [node.vote(3, OTHER)]
    # The journal has the vote of round 1, and not the timeout of round 1 that came after it.
    node = OneCore()
    node.receive(ONE)
    for message, reason in [(timeout_word(1), "outdated"), (vote_word(OTHER), "outdated")]:
        after = OneCore(journal=node.journal, answered=False)
        after.answer_from(0, message=message)
        assert after.core.lockout.reason == reason


@pytest.mark.parametrize("message", [vote_word(ONE), timeout_word(1), timeout_word(7)])
def test_a_word_that_is_newer_than_the_journal_silences_its_producer(message):
    node = OneCore(answered=False)
    node.answer_from(0)
    effects = node.answer_from(1, message=message)
    assert node.core.lockout.reason == "outdated"
    assert read_journal(node.journal, 0).lockout == SigningLockout("outdated", 0, None)
    assert of_type(effects, LockoutChanged)[0].reason == "outdated"
    assert said(node.receive(OTHER), Vote) == []
    node.work()
    assert said(node.fire("round"), Timeout) == []


def test_a_word_that_the_journal_knows_or_that_is_forged_silences_nobody():
    node = OneCore()
    node.receive(ONE)
    stranger = vote_word(PEERS.block(2, ONE), index=2)
    proposal = SignedMessage("proposal", 0, 9, ONE.block_id, 0, bytes(64))
    for message in (
        vote_word(ONE),
        stranger,
        proposal,
        SignedMessage("gossip", 0, 9, b"", 0, b""),
        SignedMessage("vote", 0, -1, b"", 0, b""),
    ):
        after = OneCore(journal=node.journal, answered=False)
        after.answer_from(0, message=message)
        after.answer_from(1)
        assert after.core.lockout is None, message


def test_a_forgotten_timeout_or_word_in_a_certificate_is_as_good_as_told():
    node = OneCore()
    node.notice(PEERS.qc(ONE, (0, 1, 3)))
    assert node.core.lockout.reason == "outdated"
    node = OneCore(1)
    node.receive(ONE)
    assert node.core.lockout.reason == "outdated"
    node = OneCore()
    node.work()
    (timeout,) = said(node.fire("round"), Timeout)
    again = OneCore(journal=node.journal)
    qc = PEERS.qc(ONE)
    two = SignedMessage("timeout", 0, timeout.round, b"", 0, timeout.signature)
    assert again.core._voter.remembers(two)
    assert not again.core._voter.remembers(SignedMessage("timeout", 0, timeout.round, b"", qc.round, bytes(64)))


def test_another_word_of_the_journals_last_round_silences_its_producer_wherever_it_is_found():
    """R34: told in an answer, alone, or in a certificate: with any other id of that round something was forgotten."""
    three = OneCore()
    three.receive(ONE)
    other = OneCore(journal=three.journal)
    other.vote_from(3, OTHER)
    assert other.core.lockout.reason == "outdated"
    certified = OneCore(journal=three.journal)
    certified.notice(PEERS.qc(OTHER, (0, 1, 3)))
    assert certified.core.lockout.reason == "outdated"
    given_up = OneCore(journal=three.journal)
    given_up.notice(GENESIS_QC, PEERS.tc(1, 0, signers=(0, 1, 3)))
    assert given_up.core.lockout.reason == "outdated"
    known = OneCore(journal=three.journal)
    known.vote_from(3, ONE)
    known.notice(PEERS.qc(ONE, (0, 1, 3)))
    assert known.core.lockout is None


def test_what_was_said_where_a_silence_ended_does_not_begin_another_one():
    """R35: it may have signed in round 3, the last of those that it waited out; a word from there is no news."""
    node = OneCore(6, count=7, journal=[RESTORED], answered=False)
    for peer in range(5):
        node.answer_from(peer, signed_round=1, qc=node.qc(node.block(1)))
    finalize(node, 1, 4)
    assert node.core.lockout is None
    assert node.core.last_voted_round == 2
    node.vote_from(6, node.chain(1, 2)[1])
    assert node.core.lockout is None


def test_a_restored_producer_is_silent_until_a_block_above_all_that_it_can_have_signed_is_final():
    """R35: the others signed in round 2 at most, so it signed in round 3 at most: it waits for a block above that."""
    node = OneCore(6, count=7, journal=[RESTORED], answered=False)
    assert node.core.lockout.reason == "restored"
    chain = node.chain(1, 2, 3, 4, 5)
    for peer, signed_round in enumerate([1, 2, 0, 2]):
        node.answer_from(peer, signed_round=signed_round, qc=node.qc(chain[0]))
    assert read_journal(node.journal, 0).lockout.above_round is None
    node.answer_from(4, signed_round=1, qc=node.qc(chain[0]))
    assert read_journal(node.journal, 0).lockout == SigningLockout("restored", 0, 3)
    assert "round 3" in node.core.lockout.until
    assert said(finalize(node, 1, 4), Vote) == []
    assert node.core.finalized.round == 3
    assert said(node.receive(chain[4]), Vote) == []
    effects = node.notice(node.qc(chain[4]))
    assert node.core.finalized.round == 4
    assert of_type(effects, LockoutChanged) == [LockoutChanged(reason="", until="")]
    assert read_journal(node.journal, 0).lockout is None
    assert node.core.last_voted_round == 3
    seven = node.block(7, chain[4], tc=node.tc(6, 5))
    assert said(node.receive(seven), Vote) == [node.vote(6, seven)]


def test_the_rounds_of_producers_that_are_silent_or_ask_themselves_say_nothing_about_ones_own():
    node = OneCore(6, count=7, journal=[RESTORED], answered=False)
    for peer in range(4):
        node.answer_from(peer)
    for signing_state in (ASKING, LOCKED_OUT):
        node.answer_from(4, signing_state=signing_state)
        assert read_journal(node.journal, 0).lockout.above_round is None
    node.answer_from(4)
    assert read_journal(node.journal, 0).lockout.above_round == 1


def test_a_silent_producer_stays_silent_over_a_crash_and_asks_again():
    node = OneCore(journal=[RESTORED], answered=False)
    for after in (node.restarted(), OneCore(journal=list(node.core.journal_snapshot()))):
        assert after.core.lockout.reason == "restored"
        assert said(after.receive(ONE), Vote) == []
    for peer in range(3):
        node.answer_from(peer)
    after = OneCore(journal=node.journal, answered=False)
    assert read_journal(after.journal, 0).lockout == SigningLockout("restored", 0, 1)
    assert said(after.started, LastSignedRequest)


def test_the_mark_stands_before_every_word_of_the_new_life():
    node = OneCore(journal=[RESTORED], answered=False)
    effects = list(node.started)
    for peer in range(3):
        effects += node.answer_from(peer)
    assert [type(effect) for effect in effects if isinstance(effect, Persist)] == [Persist]
    assert said(effects, Vote) + said(effects, Proposal) + said(effects, Timeout) == []


def test_with_more_silent_producers_than_the_chain_tolerates_the_report_says_that_it_stands_still():
    node = OneCore(journal=[RESTORED], answered=False)
    assert "restart" not in node.core.lockout.until
    node.answer_from(0, signing_state=LOCKED_OUT)
    assert not node.core.lockout.can_end


def test_a_lone_producer_that_was_restored_goes_on_above_what_its_ledger_proves():
    node = OneCore(0, count=1, journal=[RESTORED])
    assert node.core.lockout is None
    assert read_journal(node.journal, 0).lockout is None
    one = node.block(1)
    core = Core(
        node.settings,
        CHAIN_ID,
        node.schedule,
        node.keys[0],
        finalized=one,
        finalized_qc=node.qc(one),
        round_zero_id=one.header.parent_id,
        check=CHECK,
    )
    assert (core.round, core.last_voted_round) == (2, 2)


# From epoch to epoch


def core_of_next_epoch(node, before, producers=None):
    schedule = Schedule(1, producers or node.schedule.producers)
    return Core(
        node.settings,
        CHAIN_ID,
        schedule,
        node.keys[3],
        finalized=ONE,
        finalized_qc=GENESIS_QC.__class__(epoch=1, round=0, block_id=ONE.block_id, votes=()),
        round_zero_id=ONE.block_id,
        check=CHECK,
        before=before,
    )


def test_who_spoke_in_the_epoch_before_speaks_at_once_and_who_did_not_asks():
    """R36."""
    spoke, asked, stranger = OneCore(), OneCore(answered=False), OneCore(None)
    assert core_of_next_epoch(spoke, spoke.core).lockout is None
    for before in (asked.core, stranger.core, None):
        assert core_of_next_epoch(spoke, before).lockout.reason == ASKING


def test_a_silence_lasts_into_the_next_epoch():
    node = OneCore(journal=[RESTORED], answered=False)
    assert core_of_next_epoch(node, node.core).journal_snapshot()
    unknown = core_of_next_epoch(node, node.core)
    assert read_journal(unknown.journal_snapshot(), 1).lockout == SigningLockout("restored", 1, None)
    for peer in range(3):
        node.answer_from(peer)
    known = core_of_next_epoch(node, node.core)
    assert read_journal(known.journal_snapshot(), 1).lockout == SigningLockout("restored", 1, 1)
    known.handle(Started(now_ms=NOW_MS))
    assert known.lockout.reason == "restored"


def test_other_producers_are_asked_anew_how_far_they_are():
    """R36: those who told R need not be in the quorum that led this producer on, and know nothing of it then."""
    node = OneCore(journal=[RESTORED], answered=False)
    for peer in range(3):
        node.answer_from(peer)
    keys = Peers(8).schedule.producers
    for producers in (keys[3:7], keys[1:5], keys[:7]):
        other = core_of_next_epoch(node, node.core, producers)
        assert read_journal(other.journal_snapshot(), 1).lockout == SigningLockout("restored", 1, None)
        assert said(other.handle(Started(now_ms=NOW_MS)), LastSignedRequest)
    again = core_of_next_epoch(node, node.core, tuple(reversed(keys[:4])))
    assert read_journal(again.journal_snapshot(), 1).lockout == SigningLockout("restored", 1, 1)


def test_the_mark_is_read_in_every_later_epoch_though_nobody_knows_its_producers():
    mark = encode_lockout_record(0, 0, SigningLockout("restored", 0, 7))
    node = OneCore(journal=[mark], epoch=1, root=ONE)
    assert read_journal(node.core.journal_snapshot(), 1).lockout == SigningLockout("restored", 1, None)
    assert read_journal([RESTORED], 5).lockout == SigningLockout("restored", 0, None)


# A ledger that is behind the journal


def words_of_epoch_one():
    """The journal of a producer that voted in round 1 of epoch 1, and that vote."""
    node = OneCore(epoch=1, root=ONE)
    block = node.block(1)
    return node.journal, said(node.receive(block), Vote)[0]


def test_a_ledger_that_was_put_back_does_not_make_the_journal_forget_a_later_epoch():
    """R37: the records of epoch 1 are kept while the store is in epoch 0, over every rewrite, and then stand again."""
    journal, vote = words_of_epoch_one()
    node = OneCore(journal=journal)
    for before in (node, OneCore(journal=list(node.core.journal_snapshot()))):
        after = core_of_next_epoch(before, before.core)
        assert after.last_voted_round == 1
        assert read_journal(after.journal_snapshot(), 1).vote == vote
        assert all(decode(record, JournalRecord).epoch == 1 for record in after.journal_snapshot())


def test_in_an_epoch_that_its_journal_has_left_a_producer_signs_nothing():
    """R22: it went on only because the boundary was final; what it said before that is gone with the old journal."""
    node = OneCore(journal=words_of_epoch_one()[0])
    assert said(node.receive(ONE), Vote) == []
    node.work()
    assert said(node.fire("round"), Timeout) == []
    assert "epoch 1" in node.core.lockout.until
    assert LockoutChanged(*node.core.lockout[:2]) in node.started
    request = LastSignedRequest(epoch=0, asked_at_ms=5)
    (answer,) = told(node.handle(LastSignedRequested(request=request, sender=1, now_ms=NOW_MS)), 1, LastSignedResponse)
    assert answer.signing_state == LOCKED_OUT


def test_a_silence_begun_while_the_ledger_is_behind_outlasts_what_the_later_records_say_of_it():
    journal, _ = words_of_epoch_one()
    node = OneCore(journal=[*journal, RESTORED], answered=False)
    assert read_journal(node.core.journal_snapshot(), 0).lockout == SigningLockout("restored", 0, None)
    after = core_of_next_epoch(node, node.core)
    assert read_journal(after.journal_snapshot(), 1).lockout == SigningLockout("restored", 1, None)


def test_what_a_silent_producer_said_before_may_still_be_said_again():
    node = OneCore()
    node.receive(ONE)
    after = OneCore(journal=[*node.journal, RESTORED], answered=False)
    assert [effect.message for effect in of_type(after.started, Broadcast) if isinstance(effect.message, Vote)] == [
        node.vote(3, ONE)
    ]
