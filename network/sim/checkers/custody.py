"""Checkers: custodians keep what the chain says, and nothing that it calls erased."""

from __future__ import annotations

from network.sim.history import (
    Asked,
    ChainAudit,
    ClipKept,
    ClipTaken,
    CustodyAudit,
    History,
    NodeRestored,
    NodeStarted,
    Violation,
)

NOTHING_KEPT_RECORDS_COUNT = 9
"""So many records without a single clip are no accident: then the run has tried nothing of custody."""


def check_chain_equals_store(history: History) -> list[Violation]:
    """A store equals the chain at its checkpoint, never ahead.

    At the end it has every clip that a robot gave it or another honest custodian has.
    """
    found: list[Violation] = []
    for item in history.observations:
        if item.node in history.byzantine:
            continue
        if isinstance(item, NodeStarted) and item.custody_height > item.height:
            text = f"the store followed block {item.custody_height}, and the ledger ends at {item.height}"
            found.append(Violation("chain_equals_store", item.at_ms, item.node, text))
        elif isinstance(item, CustodyAudit):
            found += [Violation("chain_equals_store", item.at_ms, item.node, text) for text in _differences(item)]
    audits = _honest_audits(history)
    return found + _not_fetched(audits) + _not_kept(history, audits)


def _not_fetched(audits: list[CustodyAudit]) -> list[Violation]:
    return [
        Violation(
            "chain_equals_store",
            audit.at_ms,
            audit.node,
            f"the clip of record {record_id.hex()[:8]} is missing, and node {other.node} has it",
        )
        for audit in audits
        for other in audits
        if other.checkpoint == audit.checkpoint
        for record_id in sorted(set(audit.missing) & set(other.confirmed))
    ]


def _not_kept(history: History, audits: list[CustodyAudit]) -> list[Violation]:
    taken: dict[int, set[bytes]] = {}
    for item in history.observations:
        if isinstance(item, ClipTaken):
            taken.setdefault(item.node, set()).add(item.record_id)
        elif isinstance(item, NodeRestored):
            taken.pop(item.node, None)
    found = []
    for audit in audits:
        due = (taken.get(audit.node, set()) & set(audit.chain_recorded)) - {*audit.chain_erased, *audit.confirmed}
        found += [
            Violation(
                "chain_equals_store",
                audit.at_ms,
                audit.node,
                f"the clip of record {record_id.hex()[:8]} was taken from its robot, and is not kept",
            )
            for record_id in sorted(due)
        ]
    records = max((len(audit.chain_recorded) for audit in audits), default=0)
    if records >= NOTHING_KEPT_RECORDS_COUNT and not history.of(ClipTaken):
        text = f"{records} records are on the chain, and no custodian was given the clip of any"
        found.append(Violation("chain_equals_store", audits[0].at_ms, -1, text))
    return found


def _differences(audit: CustodyAudit) -> list[str]:
    found: list[str] = []
    if audit.checkpoint >= 0 and audit.checkpoint_id != audit.chain_id_at:
        found.append(f"the checkpoint {audit.checkpoint} names another block than the chain")
    known, recorded = {*audit.confirmed, *audit.missing, *audit.elsewhere, *audit.erased}, set(audit.chain_recorded)
    found += [
        f"record {record_id.hex()[:8]} is kept, and the chain does not know it"
        for record_id in sorted({*audit.confirmed, *audit.missing, *audit.elsewhere} - recorded)
    ]
    found += [
        f"record {record_id.hex()[:8]} is on the chain, and the store does not know it"
        for record_id in sorted(recorded - known - set(audit.chain_erased))
    ]
    found += [
        f"access request {access_id.hex()[:8]} is on one side only"
        for access_id in sorted(set(audit.granted) ^ set(audit.chain_granted))
    ]
    return found


def check_erased_means_erased(history: History) -> list[Violation]:
    """No custodian can open erased or expired records."""
    found: list[Violation] = []
    for audit in history.of(CustodyAudit):
        if audit.node in history.byzantine:
            continue
        for record_id in sorted({*audit.confirmed, *audit.missing, *audit.elsewhere} & set(audit.chain_erased)):
            text = f"record {record_id.hex()[:8]} is erased on the chain, and still kept"
            found.append(Violation("erased_means_erased", audit.at_ms, audit.node, text))
        if audit.keys_left:
            text = f"{audit.keys_left} keys of erased frames still open them"
            found.append(Violation("erased_means_erased", audit.at_ms, audit.node, text))
    return found


def check_copies(history: History) -> list[Violation]:
    """In the end each keeper has every live clip that a custodian has.

    None is lost that as many honest ones took as keep it; what dishonest ones do with theirs is nobody's promise.
    """
    found: list[Violation] = []
    honest = {audit.node: set(audit.confirmed) for audit in _honest_audits(history)}
    takers = {record_id: nodes - set(history.byzantine) for record_id, nodes in _takers(history).items()}
    for chain in history.of(ChainAudit):
        for record_id, keepers in chain.keepers:
            having = [node for node in chain.members if record_id in honest.get(node, ())]
            if not having and len(takers.get(record_id, ())) >= chain.copies:
                text = (
                    f"the clip of record {record_id.hex()[:8]} was taken by {len(takers[record_id])}, and nobody has it"
                )
                found.append(Violation("copies", chain.at_ms, -1, text))
            for node in keepers:
                if having and node in honest and node not in having:
                    text = f"it is to keep the clip of record {record_id.hex()[:8]}, and only {having} have it"
                    found.append(Violation("copies", chain.at_ms, node, text))
    return found


def check_erasures_confirmed(history: History) -> list[Violation]:
    """Whoever had a clip when its erasure was asked for, and still is a custodian, has confirmed it on the chain."""
    found: list[Violation] = []
    asked: dict[bytes, float] = {}
    for ask in history.of(Asked):
        asked.setdefault(ask.txid, ask.at_ms)
    honest = {audit.node for audit in _honest_audits(history)}
    kept = [item for item in history.of(ClipKept) if item.node in honest]
    for chain in history.of(ChainAudit):
        for erasure_id, records, confirmed in chain.erasures:
            had = {item.node for item in kept if item.record_id in records and item.at_ms < asked.get(erasure_id, 0)}
            found += [
                Violation("erasures_confirmed", chain.at_ms, node, f"it had clips of erasure {erasure_id.hex()[:8]}")
                for node in sorted(had & set(chain.members) - set(confirmed))
            ]
    return found


def _honest_audits(history: History) -> list[CustodyAudit]:
    return [audit for audit in history.of(CustodyAudit) if audit.node not in history.byzantine]


def _takers(history: History) -> dict[bytes, set[int]]:
    """Who took which clip from its robot, and has been given no older disk since."""
    found: dict[bytes, set[int]] = {}
    for item in history.observations:
        if isinstance(item, ClipTaken):
            found.setdefault(item.record_id, set()).add(item.node)
        elif isinstance(item, NodeRestored):
            for nodes in found.values():
                nodes.discard(item.node)
    return found
