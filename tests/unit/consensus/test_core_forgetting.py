"""R40: a producer signs nothing in a round in which it may have signed before, and gives such a round up at once."""

from __future__ import annotations

from consensus.chain.block import genesis_certificate
from consensus.chain.messages import ASKING, LOCKED_OUT, Proposal, Timeout, Vote
from consensus.chain.schedule import Schedule
from consensus.protocol.core import Core
from consensus.protocol.effects import BuildBlock
from tests.sim.named_chain import CHAIN_ID
from tests.unit.consensus.one_core import CHECK, TRANSACTION, OneCore, Peers, of_type, said


def answered(node, *rounds, qc=None, signing_states=()):
    """Let others answer that they last signed in these rounds; return all effects."""
    effects = []
    for peer, number in enumerate(rounds):
        signing_state = signing_states[peer] if signing_states else "signing"
        effects += node.answer_from(peer, signed_round=number, qc=qc, signing_state=signing_state)
    return effects


def certified(node, *rounds):
    """A chain of these rounds, and the certificate of its last block, signed by others."""
    chain = node.chain(*rounds)
    return chain, node.qc(chain[-1])


def test_it_votes_only_above_the_round_after_the_last_one_that_others_signed_in():
    node = OneCore(3, answered=False)
    chain, qc = certified(node, 1, 2, 3)
    answered(node, 3, 2, qc=qc)
    four, five = node.block(4, chain[-1]), None
    for block in chain:
        node.receive(block)
    assert said(node.receive(four), Vote) == []
    five = node.block(5, four)
    assert [vote.round for vote in said(node.receive(five), Vote)] == [5]


def test_the_round_that_it_may_have_forgotten_is_given_up_at_once_and_once():
    node = OneCore(3, answered=False)
    _, qc = certified(node, 1, 2)
    effects = answered(node, 2, 2, qc=qc)
    assert [(word.round, word.qc.round) for word in said(effects, Timeout)] == [(3, 2)]
    assert node.core.last_voted_round == 3
    assert said(node.work(), Timeout) == []
    assert said(node.fire("round"), Timeout) == []


def test_a_leader_that_may_have_proposed_leads_none_of_these_rounds_and_the_next_of_its_own():
    node = OneCore(2, answered=False)
    one = node.block(1)
    node.receive(one)
    effects = [*answered(node, 1, 1, qc=node.qc(one)), *node.work()]
    assert of_type(effects, BuildBlock) == []
    assert [word.round for word in said(effects, Timeout)] == [2]
    effects = node.notice(node.qc(one), node.tc(5, 1))
    assert [order.round for order in of_type(effects, BuildBlock)] == [6]
    assert said(node.built(of_type(effects, BuildBlock)[0]), Proposal)


def test_what_it_remembers_is_said_again_and_not_given_up():
    before = OneCore(3)
    one = before.block(1)
    (vote,) = said(before.receive(one), Vote)
    node = OneCore(3, journal=before.journal, answered=False)
    effects = answered(node, 1, 1)
    assert vote in said(node.started, Vote)
    assert said(effects, Timeout) == []
    assert node.core.round == 1
    effects = node.notice(node.qc(one))
    assert [word.round for word in said(effects, Timeout)] == [2]


def test_after_a_power_cut_all_give_the_same_round_up_without_waiting_and_the_next_one_is_led():
    node = OneCore(3, answered=False)
    one = node.block(1, transactions=(TRANSACTION,))
    node.receive(one)
    effects = answered(node, 1, 1, qc=node.qc(one), signing_states=(ASKING, ASKING))
    assert [word.round for word in said(effects, Timeout)] == [2]
    for peer in (0, 1):
        effects += node.timeout_from(peer, 2, node.qc(one))
    assert node.core.round == 3
    assert [order.round for order in of_type(effects, BuildBlock)] == [3]


def test_neither_silent_producers_nor_later_answers_move_the_mark():
    node = OneCore(3, answered=False)
    _, qc = certified(node, 1, 2)
    node.answer_from(2, signed_round=2, qc=qc, signing_state=LOCKED_OUT)
    effects = answered(node, 1, 1)
    assert [word.round for word in said(effects, Timeout)] == []
    assert node.core.round == 3
    assert node.core.lockout is None
    node = OneCore(3, answered=False)
    answered(node, 0, 0)
    one = node.block(1)
    node.receive(one)
    node.answer_from(2, signed_round=2, qc=node.qc(one))
    assert said(node.receive(node.block(2, one)), Vote)


def test_at_genesis_nothing_is_forgotten():
    node = OneCore(3, answered=False)
    answered(node, 0, 0)
    assert said(node.receive(node.block(1)), Vote)


def next_core(node, boundary, producers=None):
    return Core(
        node.settings,
        CHAIN_ID,
        Schedule(1, producers or node.schedule.producers),
        node.keys[3],
        finalized=boundary,
        finalized_qc=genesis_certificate(boundary.block_id, 1),
        round_zero_id=boundary.block_id,
        check=CHECK,
        before=node.core,
    )


def test_who_may_have_left_the_epoch_before_it_forgot_gives_the_first_round_of_the_next_one_up():
    """The boundary is of round 4: a producer that may have signed there or above may have begun the next epoch.

    If others produce there, those who answered may know nothing of it: it asks again.
    """
    for told_round, is_safe in ((2, True), (3, False), (5, False)):
        node = OneCore(3, answered=False)
        one, two = node.chain(1, 2)
        boundary = node.boundary(4, two, tc=node.tc(3, 2))
        closing = node.closing(5, boundary)
        answered(node, told_round, told_round, qc=node.qc(closing))
        for block in (one, two, boundary, closing):
            node.receive(block)
        assert node.core.finalized_id == boundary.block_id
        core = next_core(node, boundary)
        assert core.lockout is None
        assert core._voter.may_sign(1) is is_safe, told_round
        assert core._voter.may_sign(2)
        others = (*node.schedule.producers[2:], *Peers(6).schedule.producers[4:])
        changed = next_core(node, boundary, others)
        assert (changed.lockout is None) is is_safe
