"""Mutants of epochs: where one ends, and what of it counts in the next (R21 to R24)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import msgspec
import pytest

from consensus.chain.block import Header
from consensus.chain.epoch_settings import Epoch
from consensus.chain.journal_records import JournalRecord, JournalState, _merge
from consensus.primitives.encoding import decode
from consensus.protocol import block_processor, core
from consensus.protocol.block_tree import BlockTree
from consensus.protocol.commit_rule import Commit, _prove
from network.sim.plan import NetworkSize
from network.sim.world.sim_chain import make_chain
from node.execution import block_executor
from tests.sim.mutants.mutant import Mutant
from tests.sim.mutants.schedules import CHANGES, CHANGES_AND_LOST_LEADERS, CUT_AT_THE_BOUNDARY, REMOVAL


def let_words_span_epochs(patch: pytest.MonkeyPatch) -> None:
    """What was said and certified in one epoch counts in the next."""

    def read(records: Iterable[bytes], epoch: int) -> JournalState:
        state = JournalState(newest_epoch=epoch)
        for data in records:
            record = decode(data, JournalRecord)
            state.lockout = record.lockout
            _merge(state, record)
        return state

    patch.setattr(core, "read_journal", read)


def ignore_the_boundary(patch: pytest.MonkeyPatch) -> None:
    """A block that decides another epoch is one like any other: transactions go on after it."""

    def next_epoch(writes: object, current: int) -> Epoch | None:
        return None

    patch.setattr(block_executor, "next_epoch", next_epoch)


def never_end_an_epoch(patch: pytest.MonkeyPatch) -> None:
    """Leaders and voters do not see that only closing blocks may follow."""
    patch.setattr(Header, "ends_epoch", property(lambda self: False))


def finalize_closing_blocks(patch: pytest.MonkeyPatch) -> None:
    """A commit among closing blocks goes beyond the boundary."""

    def choose(tree: BlockTree, chains: list) -> Commit:
        newest = chains[-1]
        return Commit(head=newest.final, proof=_prove([newest.final], newest), ends_epoch=False)

    patch.setattr(block_processor, "choose_commit", choose)


def carry_the_round_over(patch: pytest.MonkeyPatch) -> None:
    """A head of an earlier epoch counts with its round there."""
    patch.setattr(BlockTree, "root_round", property(lambda self: self.root.header.round))


def keep_the_removed(patch: pytest.MonkeyPatch) -> None:
    """Who had a seat at genesis leads and votes in every later epoch too."""
    first = tuple(key.public_key for key in make_chain(NetworkSize(4, 4)).producers)
    decide = block_executor.next_epoch

    def next_epoch(writes: Mapping[bytes, bytes | None], current: int) -> Epoch | None:
        following = decide(writes, current)
        return None if following is None else msgspec.structs.replace(following, producers=first)

    patch.setattr(block_executor, "next_epoch", next_epoch)


FOLLOWING = (
    Mutant("let words span an epoch", "R24", let_words_span_epochs, CUT_AT_THE_BOUNDARY, frozenset({"liveness"})),
    Mutant("ignore the boundary", "R21", ignore_the_boundary, CHANGES, frozenset({"epoch_in_force"})),
    Mutant("a removed producer's votes still count", "R21", keep_the_removed, REMOVAL, frozenset({"epoch_in_force"})),
    Mutant("ends_epoch always False", "R21", never_end_an_epoch, CHANGES, frozenset({"liveness"})),
    Mutant(
        "closing blocks final", "R22", finalize_closing_blocks, CHANGES_AND_LOST_LEADERS, frozenset({"code_faults"})
    ),
    Mutant("the root round of another epoch", "R23", carry_the_round_over, CHANGES, frozenset({"liveness"})),
)
