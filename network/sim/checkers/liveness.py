"""Checkers: finality goes on, after faults and under floods, and no node fails by itself."""

from __future__ import annotations

import math

from consensus.chain.epoch_settings import ChainSettings
from network.sim.history import (
    Asked,
    BlockFinalized,
    CodeFault,
    Ended,
    Flooded,
    Healed,
    History,
    NodeRefusedStart,
    PeerCutOff,
    TimeoutSent,
    Violation,
    VoteSent,
)

ROUNDS_PER_FAULTY = 3
ROUNDS_AT_LEAST = 12
FLOOD_SLOWER_MAX = 5.0
FLOOD_SHARE = 0.95
FLOOD_CALLS_MIN_COUNT = 10
LOST_ROUND_MS = ChainSettings().base_timeout_ms
EXPECTED_REFUSALS = frozenset({"JOURNAL_UNWRITABLE", "JOURNAL_OUTDATED"})
"""A full disk, and a journal put back from a backup: such a node must not take part, and says so."""


def rounds_allowed(faulty: int) -> int:
    """Return the rounds after healing for every honest node to store a new final block."""
    return ROUNDS_AT_LEAST + ROUNDS_PER_FAULTY * faulty


def check_liveness(history: History) -> list[Violation]:
    """After healing, with at most f faulty, blocks finalize within bounded rounds."""
    found: list[Violation] = []
    for healed in history.of(Healed):
        allowed = rounds_allowed(len(history.byzantine))
        first = _first_after(history, healed)
        for node in healed.honest:
            block = first.get(node)
            if block is None:
                found.append(Violation("liveness", healed.at_ms, node, "nothing became final after all was healed"))
            elif (taken := _rounds_between(history, healed, block)) > allowed:
                text = f"the first new block after round {healed.round} took {taken} rounds, not {allowed} at most"
                found.append(Violation("liveness", block.at_ms, node, text))
    for ended in history.of(Ended):
        if not ended.settled:
            text = f"not all was answered and stored everywhere in the end: heights {ended.heights}"
            found.append(Violation("liveness", ended.at_ms, -1, text))
        if not ended.reached:
            text = f"the rounds that were asked for were not played in time: rounds {ended.rounds}"
            found.append(Violation("liveness", ended.at_ms, -1, text))
    return found


def _rounds_between(history: History, healed: Healed, block: BlockFinalized) -> int:
    if block.epoch <= healed.epoch:
        return block.round - healed.round
    last = {healed.epoch: healed.round, block.epoch: block.round}
    for observation in history.observations:
        if observation.at_ms > block.at_ms:
            break
        if not isinstance(observation, VoteSent | TimeoutSent) or observation.node in history.byzantine:
            continue
        if healed.epoch <= observation.epoch < block.epoch:
            last[observation.epoch] = max(last.get(observation.epoch, 0), observation.round)
    return sum(last.values()) - healed.round


def _first_after(history: History, healed: Healed) -> dict[int, BlockFinalized]:
    first: dict[int, BlockFinalized] = {}
    for block in history.of(BlockFinalized):
        if block.at_ms >= healed.at_ms and block.stored and block.height > healed.height:
            first.setdefault(block.node, block)
    return first


def check_finality_under_flood(history: History) -> list[Violation]:
    """With at most f flooding nodes and no other fault, finality stays fast.

    A flooder cut off counts as down. A call counts from reaching an honest node, and may wait one lost round per node
    cut off.
    """
    floods = history.of(Flooded)
    if not floods:
        return []
    since_ms, until_ms = min(flood.at_ms for flood in floods), max(flood.until_ms for flood in floods)
    nodes = frozenset(flood.node for flood in floods)
    asked: dict[bytes, float] = {}
    for ask in history.of(Asked):
        if ask.node not in nodes:
            asked.setdefault(ask.txid, ask.at_ms)
    final: dict[bytes, float] = {}
    for block in history.of(BlockFinalized):
        if block.stored and block.node not in nodes | history.byzantine:
            for txid in block.txids:
                final.setdefault(txid, block.at_ms)
    taken = {txid: final.get(txid, math.inf) - at_ms for txid, at_ms in asked.items()}
    quiet = [taken[txid] for txid, at_ms in asked.items() if at_ms + taken[txid] < since_ms]
    flooded = [taken[txid] for txid, at_ms in asked.items() if since_ms <= at_ms < until_ms]
    if len(quiet) < FLOOD_CALLS_MIN_COUNT or not flooded:
        text = f"the run shows nothing: {len(quiet)} calls before the flood, {len(flooded)} during it"
        return [Violation("finality_under_flood", since_ms, -1, text)]
    usual_ms, taken_ms = _percentile(quiet), _percentile(flooded)
    cut_off = {cut.peer for cut in history.of(PeerCutOff) if cut.peer in nodes and cut.at_ms < until_ms}
    if taken_ms <= FLOOD_SLOWER_MAX * usual_ms + LOST_ROUND_MS * len(cut_off):
        return []
    kinds = " and ".join(sorted({flood.text for flood in floods}))
    text = f"under {kinds} calls took {taken_ms:.0f} ms to become final (p95), {usual_ms:.0f} ms before"
    return [Violation("finality_under_flood", since_ms, -1, text)]


def _percentile(values: list[float]) -> float:
    ordered = sorted(values)
    return ordered[max(0, math.ceil(FLOOD_SHARE * len(ordered)) - 1)]


def check_code_faults(history: History) -> list[Violation]:
    """No uncaught exceptions, endless frames, halted honest cores, unjustified start refusals."""
    found = [Violation("code_faults", fault.at_ms, fault.node, fault.text) for fault in history.of(CodeFault)]
    found += [
        Violation("code_faults", refused.at_ms, refused.node, f"refused to start: {refused.code}")
        for refused in history.of(NodeRefusedStart)
        if refused.node not in history.byzantine and refused.code not in EXPECTED_REFUSALS
    ]
    return found
