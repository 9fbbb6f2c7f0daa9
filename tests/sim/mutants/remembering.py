"""Mutants of the journal: what is written before a word is spoken, and what comes back after a crash (R12, R13, R33)."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest

from consensus.chain.journal_records import JournalState, read_journal
from consensus.chain.messages import Vote
from consensus.protocol import core
from consensus.protocol.block_tree import BlockNode
from consensus.protocol.effects import Effect, Persist
from consensus.protocol.journal_builder import JournalBuilder
from consensus.protocol.signing_guard import SigningGuard
from consensus.protocol.voter import Voter
from node.consensus.engine import Engine
from node.consensus.journal import Journal, _frame
from tests.sim.mutants.mutant import Mutant
from tests.sim.mutants.schedules import CHAOS, OLD_JOURNAL, POWER_CUTS, STORES_BEHIND
from tests.sim.mutants.scripts import A_WORD_THAT_NOBODY_TELLS, TWO_ROUNDS_GIVEN_UP


def _forget(patch: pytest.MonkeyPatch, forget: Callable[[JournalState], None]) -> None:
    """Read the journal back without something that it says."""

    def read(records: Iterable[bytes], epoch: int) -> JournalState:
        state = read_journal(records, epoch)
        forget(state)
        return state

    patch.setattr(core, "read_journal", read)


def forget_the_last_voted_round(patch: pytest.MonkeyPatch) -> None:
    """After a restart all rounds are new."""

    def forget(state: JournalState) -> None:
        state.last_voted_round = 0

    _forget(patch, forget)


def lose_the_tc(patch: pytest.MonkeyPatch) -> None:
    """After a restart the node is back behind its highest QC, whatever it gave up since."""

    def forget(state: JournalState) -> None:
        state.entered_by = None

    _forget(patch, forget)


def speak_where_it_may_have_spoken(patch: pytest.MonkeyPatch) -> None:
    """Once others have answered a producer speaks in any round, also where only who did not answer heard it before."""
    patch.setattr(SigningGuard, "_first_safe_round", lambda self: 1)


def propose_unrecorded(patch: pytest.MonkeyPatch) -> None:
    """A leader's own block and its vote for it are said without a record: after a crash it makes another one.

    R40 would make up for it.
    """
    speak_where_it_may_have_spoken(patch)
    original = Voter.vote

    def vote(self: Voter, *arguments: object, is_own: bool = False) -> tuple[Vote, list[Effect]]:
        said, effects = original(self, *arguments, is_own=is_own)  # type: ignore[arg-type]
        return said, [effect for effect in effects if not (is_own and isinstance(effect, Persist))]

    patch.setattr(Voter, "vote", vote)


def skip_the_sync(patch: pytest.MonkeyPatch) -> None:
    """The journal is written, and never synced."""

    def sync(self: Journal) -> int:
        entries, self._unwritten = self._unwritten, []
        if entries:
            self._file.append(b"".join(_frame(self._identity, entry, 0) for entry in entries))
            self._synced = entries[-1].sequence
        return self._synced

    patch.setattr(Journal, "sync", sync)


def send_before_the_sync(patch: pytest.MonkeyPatch) -> None:
    """What stands behind a record leaves at once; the record is synced a moment later. R40 would make up for it."""
    speak_where_it_may_have_spoken(patch)

    def persist(self: Engine, records: tuple[bytes, ...]) -> None:
        if self._journal_writer.append(records):
            self._loop.call_later(0.002, self._journal_writer.sync)

    patch.setattr(Engine, "_persist", persist)


def forget_final_blocks_early(patch: pytest.MonkeyPatch) -> None:
    """What is final leaves the journal, though no store has it yet."""

    def note_finalized(self: JournalBuilder, nodes: Iterable[BlockNode]) -> None:
        for node in nodes:
            self._journalled.discard(node.block_id)

    patch.setattr(JournalBuilder, "note_finalized", note_finalized)


def trust_a_restored_journal(patch: pytest.MonkeyPatch) -> None:
    """A producer speaks at once, whatever others heard of it."""
    patch.setattr(SigningGuard, "is_blocking", property(lambda self: False))


TWO_WORDS = frozenset({"no_double_vote", "no_double_proposal"})
FORGETFUL = frozenset({"no_double_vote", "no_double_proposal", "liveness"})
"""Nodes that forget what others remember fall silent (R34): if most of them do, nothing becomes final any more."""

REMEMBERING = (
    Mutant("forget last_voted_round", "R13", forget_the_last_voted_round, CHAOS, FORGETFUL),
    Mutant("lose the TC at a restart", "R13", lose_the_tc, TWO_ROUNDS_GIVEN_UP, frozenset({"no_double_vote"})),
    Mutant(
        "a second proposal after a crash", "R2, R12", propose_unrecorded, POWER_CUTS, frozenset({"no_double_proposal"})
    ),
    Mutant("skip the journal's sync", "R12", skip_the_sync, POWER_CUTS, FORGETFUL),
    Mutant("send before the sync", "R12", send_before_the_sync, POWER_CUTS, TWO_WORDS),
    Mutant(
        "forget final blocks that are not stored",
        "R12",
        forget_final_blocks_early,
        STORES_BEHIND,
        frozenset({"liveness"}),
    ),
    Mutant("trust a restored journal", "R33, R34", trust_a_restored_journal, OLD_JOURNAL, TWO_WORDS),
    Mutant(
        "speak where it may have spoken",
        "R40",
        speak_where_it_may_have_spoken,
        A_WORD_THAT_NOBODY_TELLS,
        frozenset({"no_double_vote", "no_double_proposal"}),
    ),
)
