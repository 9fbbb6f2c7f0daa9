"""Two schedules that chance does not find: each breaks agreement if one rule is turned off, and only then (R4, R8).

Four real cores, whose messages are carried by hand: everybody hears only what the story says.
"""

from __future__ import annotations

from consensus.chain.messages import Proposal, Timeout, Vote
from consensus.protocol.block_tree import BlockTree, Execution, TwoChain
from consensus.protocol.effects import BuildBlock, Effect
from consensus.protocol.events import TimeoutReceived, VoteReceived
from consensus.protocol.voter import Voter
from tests.unit.consensus.one_core import GENESIS_QC, TRANSACTION, OneCore, committed, of_type, said


class Table:
    """Four producers at a table; `final` collects what any of them calls final, by height."""

    def __init__(self) -> None:
        self.nodes = [OneCore(index) for index in range(4)]
        self.final: dict[int, set[bytes]] = {}

    def note(self, effects: list[Effect]) -> list[Effect]:
        for block in committed(effects):
            self.final.setdefault(block.header.height, set()).add(block.block_id)
        return effects

    def proposes(self, index: int, effects: list[Effect]) -> Proposal:
        """The leader builds the block that it ordered among these effects, and votes for it."""
        order = of_type(effects, BuildBlock)[0]
        transactions = () if order.empty or order.height > 1 else (TRANSACTION,)
        return said(self.note(self.nodes[index].built(order, transactions)), Proposal)[0]

    def votes(self, proposal: Proposal, *indexes: int) -> list[Vote]:
        """These receive the proposal, and vote for it or not."""
        votes: list[Vote] = []
        for index in indexes:
            votes += said(self.note(self.nodes[index].receive(proposal.block)), Vote)
        return votes

    def counts(self, index: int, votes: list[Vote]) -> list[Effect]:
        """Somebody receives these votes."""
        node = self.nodes[index]
        effects: list[Effect] = []
        for vote in votes:
            if vote.index != index:
                event = VoteReceived(vote=vote, now_ms=node.now_ms)
                effects += self.note(node.executed(node.handle(event)))
        return effects

    def gives_up(self, *indexes: int) -> list[Timeout]:
        """The timers of these run out."""
        timeouts: list[Timeout] = []
        for index in indexes:
            self.nodes[index].work()
            timeouts += said(self.note(self.nodes[index].fire("round")), Timeout)
        return timeouts

    def hears(self, index: int, timeouts: list[Timeout]) -> list[Effect]:
        """Somebody receives these timeouts."""
        node = self.nodes[index]
        effects: list[Effect] = []
        for timeout in timeouts:
            if timeout.index != index:
                event = TimeoutReceived(timeout=timeout, sender=timeout.index, now_ms=node.now_ms)
                effects += self.note(node.executed(node.handle(event)))
        return effects


def let_votes_follow_timeouts(monkeypatch):
    """Turn R4's second half off: only votes forbid votes."""

    def may_sign(self: Voter, round_number: int) -> bool:
        last = 0 if self.last_vote is None else self.last_vote.round
        return self.index is not None and round_number > last

    monkeypatch.setattr(Voter, "may_sign", may_sign)


def let_gaps_commit(monkeypatch):
    """Turn R8's "of the next round" off: any certified child makes its parent final."""

    def two_chains(self: BlockTree) -> list[TwoChain]:
        found = []
        for node in self.nodes.values():
            parent, qc = node.parent, self.certificates.get(node.block_id)
            if (
                parent is not None
                and parent is not self.root
                and parent.execution is Execution.VALID
                and qc is not None
            ):
                found.append(TwoChain(final=parent, child=node, child_qc=qc))
        return sorted(found, key=lambda chain: chain.final.header.round)

    monkeypatch.setattr(BlockTree, "two_chains", two_chains)


def play_a_vote_after_a_timeout() -> Table:
    """Producer 1 lies. Producer 0 gives round 2 up, and only then receives that round's block."""
    table = Table()
    liar = table.nodes[1]
    first = Proposal(block=liar.block(1, transactions=(TRANSACTION,)))
    table.votes(first, 0, 2, 3)
    first_qc = liar.qc(first.block, (0, 1, 2))

    given_up = table.gives_up(0, 3)
    one_lost = liar.tc(1, 0, signers=(0, 1, 3))
    for index in (0, 3):
        table.hears(index, given_up)
        table.nodes[index].notice(GENESIS_QC, one_lost)
    second = table.proposes(2, table.note(table.nodes[2].notice(first_qc)))
    table.gives_up(0, 3)
    late = table.votes(second, 0)
    table.counts(2, [*late, liar.vote(1, second.block)])

    two_lost = liar.tc(2, 0, signers=(0, 1, 3))
    other = table.proposes(3, table.nodes[3].notice(GENESIS_QC, two_lost))
    votes = [*table.votes(other, 0), liar.vote(1, other.block)]
    table.counts(3, votes)
    after = table.proposes(0, table.counts(0, [table.nodes[3].vote(3, other.block), votes[-1]]))
    table.counts(3, [*table.votes(after, 3), table.nodes[0].vote(0, after.block), liar.vote(1, after.block)])
    return table


def test_a_vote_after_a_timeout_would_finalize_two_blocks(monkeypatch):
    let_votes_follow_timeouts(monkeypatch)
    assert len(play_a_vote_after_a_timeout().final[1]) == 2


def test_by_the_rules_neither_a_timeout_nor_a_gap_finalizes_two_blocks():
    assert len(play_a_vote_after_a_timeout().final[1]) == 1
    table = play_two_branches_of_alternating_rounds()
    assert table.final == {}
    assert not any(node.core.halted for node in table.nodes)


def play_two_branches_of_alternating_rounds() -> Table:
    """Nobody lies. Each certificate is late for all but one, so that two branches grow in turn: rounds 1, 3 and 2, 4."""
    table = Table()
    first = table.proposes(1, table.nodes[1].work())
    table.counts(1, table.votes(first, 0, 2, 3))

    lost = table.gives_up(0, 2, 3)
    effects = {index: table.hears(index, lost) for index in (0, 2, 3)}
    second = table.proposes(2, effects[2])
    table.counts(2, table.votes(second, 0, 3))

    lost = table.gives_up(0, 1, 3)
    table.votes(second, 1)
    third = table.proposes(3, table.hears(3, lost))
    table.counts(3, table.votes(third, 0, 1))

    lost = table.gives_up(0, 1, 2)
    fourth = table.proposes(0, table.hears(0, lost))
    table.counts(0, table.votes(fourth, 1, 2))
    assert [block.block.header.qc.round for block in (first, second, third, fourth)] == [0, 0, 1, 2]
    assert table.nodes[0].core.high_qc.round == 4
    return table


def test_a_commit_over_a_gap_of_rounds_would_finalize_two_blocks(monkeypatch):
    let_gaps_commit(monkeypatch)
    assert len(play_two_branches_of_alternating_rounds().final[1]) == 2
