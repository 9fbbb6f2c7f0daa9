"""Schedules that chance does not find: four production cores, whose messages are carried by hand.

Everybody hears only what the story says. Without the mutant the story ends where a core refuses its part in it.
"""

from __future__ import annotations

from consensus.chain.messages import Proposal, Timeout, Vote
from consensus.protocol.effects import BuildBlock
from network.sim.checkers import Violation
from tests.sim.mutants.mutant import Schedule
from tests.sim.test_scripted_schedules import Table, play_two_branches_of_alternating_rounds
from tests.unit.consensus.one_core import GENESIS_QC, TRANSACTION, OneCore, of_type, said


def disagreements(table: Table) -> list[Violation]:
    """Return the heights at which two blocks are final."""
    return [
        Violation("agreement", 0.0, -1, f"two blocks are final at height {height}")
        for height, blocks in sorted(table.final.items())
        if len(blocks) > 1
    ]


def play_alternating_rounds(_seed: int) -> list[Violation]:
    """Nobody lies, and every certificate is late: two branches grow in turn, in rounds 1, 3 and 2, 4."""
    return disagreements(play_two_branches_of_alternating_rounds())


def play_a_block_left_behind(_seed: int) -> list[Violation]:
    """Producer 3 lies. Node 2 alone sees that block 1 is final; the liar's block in round 3 leaves it behind."""
    table = Table()
    nodes, liar = table.nodes, table.nodes[3]
    first = table.proposes(1, nodes[1].work())
    votes = [*table.votes(first, 0, 2), nodes[1].vote(1, first.block)]
    second = table.proposes(2, table.counts(2, votes))
    table.counts(2, table.votes(second, 0, 1))

    given_up = [*table.gives_up(0, 1), liar.timeout(3, 2, GENESIS_QC)]
    for index in (0, 1):
        table.hears(index, given_up)
    lost = liar.tc(2, 1, 1, 0, signers=(0, 1, 3))
    third = Proposal(block=liar.block(3, tc=lost, transactions=(TRANSACTION,)))
    votes = [*table.votes(third, 0, 1), liar.vote(3, third.block)]
    if len(votes) == 3:
        fourth = table.proposes(0, table.counts(0, votes))
        table.counts(0, [*table.votes(fourth, 1), liar.vote(3, fourth.block)])
    return disagreements(table)


def play_two_rounds_given_up(_seed: int) -> list[Violation]:
    """A node gives rounds 2 and 3 up, and learns of a certificate in between. Then it crashes, and comes back."""
    node = OneCore(0)
    first = node.block(1, transactions=(TRANSACTION,))
    qc = node.qc(first, (1, 2, 3))
    words: list[Timeout] = []
    node.work()
    words += said(node.fire("round"), Timeout)
    for peer in (1, 2):
        node.timeout_from(peer, 1)
    words += said(node.fire("round"), Timeout)
    for peer in (1, 2):
        node.timeout_from(peer, 2, qc)
    words += said(node.fire("round"), Timeout)
    again = node.restarted()
    again.work()
    words += said([*again.started, *again.fire("round"), *again.fire("resend")], Timeout)

    rounds: dict[int, bytes] = {}
    found = [
        Violation("no_double_vote", 0.0, 0, f"gave up round {word.round} with two different words")
        for word in words
        if rounds.setdefault(word.round, word.signature) != word.signature
    ]
    if len(rounds) != 3:
        raise AssertionError("the node did not give three rounds up")
    return found


def play_a_word_that_nobody_tells(_seed: int) -> list[Violation]:
    """A leader's block reaches one node only. The leader is put back from a backup taken before, and asks two others."""
    node = OneCore(2)
    first = node.block(1, transactions=(TRANSACTION,))
    backup = [*node.journal]
    blocks: list[Proposal] = []
    votes: list[Vote] = []
    for transactions in ((), (TRANSACTION,)):
        effects = [*node.receive(first), *node.notice(node.qc(first, (0, 1, 3)))]
        for order in of_type(effects, BuildBlock):
            effects = node.built(order, transactions)
            blocks += said(effects, Proposal)
            votes += said(effects, Vote)
        node = OneCore(2, journal=backup, answered=False)
        for peer in (0, 1):
            node.answer_from(peer, signed_round=1, qc=node.qc(first, (0, 1, 3)))

    if not blocks:
        raise AssertionError("the leader proposed nothing")
    found = []
    if len({block.block.block_id for block in blocks}) > 1:
        found.append(Violation("no_double_proposal", 0.0, 2, "proposed two blocks in round 2"))
    if len({vote.block_id for vote in votes}) > 1:
        found.append(Violation("no_double_vote", 0.0, 2, "voted for two blocks in round 2"))
    return found


ALTERNATING_ROUNDS = Schedule("script: alternating rounds", play_alternating_rounds, range(1))
A_BLOCK_LEFT_BEHIND = Schedule("script: a block left behind", play_a_block_left_behind, range(1))
TWO_ROUNDS_GIVEN_UP = Schedule("script: two rounds given up", play_two_rounds_given_up, range(1))
A_WORD_THAT_NOBODY_TELLS = Schedule("script: a word that nobody tells", play_a_word_that_nobody_tells, range(1))
