"""Checker: with at most f flooding nodes and no other fault, finality stays fast.

A flooder cut off counts as down. A call counts from reaching an honest node, and may wait one lost round per node cut
off.
"""

from __future__ import annotations

import math

from consensus.chain.epoch_settings import ChainSettings
from network.sim.checkers.violation import Violation
from network.sim.history import Asked, BlockFinalized, Flooded, History, PeerCutOff

SLOWER_MAX = 5.0
SHARE = 0.95
CALLS_MIN_COUNT = 10
LOST_ROUND_MS = ChainSettings().base_timeout_ms


def check_finality_under_flood(history: History) -> list[Violation]:
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
    if len(quiet) < CALLS_MIN_COUNT or not flooded:
        text = f"the run shows nothing: {len(quiet)} calls before the flood, {len(flooded)} during it"
        return [Violation("finality_under_flood", since_ms, -1, text)]
    usual_ms, taken_ms = _percentile(quiet), _percentile(flooded)
    cut_off = {cut.peer for cut in history.of(PeerCutOff) if cut.peer in nodes and cut.at_ms < until_ms}
    if taken_ms <= SLOWER_MAX * usual_ms + LOST_ROUND_MS * len(cut_off):
        return []
    kinds = " and ".join(sorted({flood.text for flood in floods}))
    text = f"under {kinds} calls took {taken_ms:.0f} ms to become final (p95), {usual_ms:.0f} ms before"
    return [Violation("finality_under_flood", since_ms, -1, text)]


def _percentile(values: list[float]) -> float:
    ordered = sorted(values)
    return ordered[max(0, math.ceil(SHARE * len(ordered)) - 1)]
