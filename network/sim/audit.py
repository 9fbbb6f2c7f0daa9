"""Compares a custodian's store with its node's chain, at the store's checkpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING

from consensus.chain.block import Block, Receipts
from consensus.primitives.encoding import decode, decode_value
from consensus.records.placement import Placement
from consensus.state.erasure import REQUEST
from consensus.state.records import RECORD
from network.sim.history import ChainAudit, CustodyAudit, History
from node.custody.chain_facts import read_placement

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from network.sim.world.sim_node import SimNode


def audit_custody(node: SimNode) -> None:
    if node.custody_key is None:
        return
    held = node.store.holdings()
    height = -1 if held.checkpoint is None else held.checkpoint.height
    recorded: set[bytes] = set()
    erased: set[bytes] = set()
    granted: set[bytes] = set()
    block_id = b""
    now_ms = 0 if held.checkpoint is None else held.checkpoint.timestamp_ms
    with node.ledger.snapshot() as snapshot:
        position = snapshot.position
        newest = -1 if position is None else position.height
        for at in range(min(height, newest) + 1):
            data, receipts = snapshot.block(at), snapshot.receipts(at)
            if data is None or receipts is None:
                continue
            if at == height:
                block_id = decode(data, Block).block_id
            for receipt in decode(receipts, Receipts).receipts:
                for event in receipt.events:
                    _follow(
                        f"{event.contract}.{event.name}", decode_value(event.data), now_ms, recorded, erased, granted
                    )
    node.cluster.history.add(
        CustodyAudit(
            node.cluster.now,
            node.index,
            height,
            b"" if held.checkpoint is None else held.checkpoint.block_id,
            tuple(sorted(held.confirmed)),
            tuple(sorted(held.missing)),
            tuple(sorted(held.elsewhere)),
            tuple(sorted(held.erased)),
            tuple(sorted(held.granted)),
            block_id,
            tuple(sorted(recorded)),
            tuple(sorted(erased)),
            tuple(sorted(granted)),
            sum(node.erase_keys.read(slot) is not None for slot in held.slots_of(erased)),
        )
    )


def placement_of(nodes: Sequence[SimNode]) -> Placement:
    """By the newest block that any of them has."""
    with max(nodes, key=lambda node: node.ledger_height).ledger.snapshot() as snapshot:
        return read_placement(snapshot)


def audit_chain(honest: Sequence[SimNode], numbers: Mapping[bytes, int], now: float, history: History) -> None:
    """Who is to keep what in the end, and who has confirmed which erasure. `numbers`: of nodes, by custodian."""
    node, placement = max(honest, key=lambda node: node.ledger_height), placement_of(honest)
    with node.ledger.snapshot() as snapshot:
        now_ms = 0 if snapshot.position is None else snapshot.position.timestamp_ms
        records = [
            record_id
            for (record_id,), row in RECORD.rows(snapshot)
            if row.status == "active" and row.expires_at_ms > now_ms
        ]
        erasures = [(erasure_id, row) for (erasure_id,), row in REQUEST.rows(snapshot)]
    history.add(
        ChainAudit(
            now,
            node.index,
            tuple(sorted(numbers[key] for key in placement.rooms)),
            placement.count,
            tuple((each, tuple(numbers[key] for key in placement.keepers(each))) for each in sorted(records)),
            tuple(
                (each, tuple(row.records), tuple(sorted(numbers[key] for key in row.receipts)))
                for each, row in sorted(erasures)
            ),
        )
    )


def _follow(
    kind: str, data: dict[str, object], now_ms: int, recorded: set[bytes], erased: set[bytes], granted: set[bytes]
) -> None:
    match kind, data:
        case "records.recorded", {"record_id": bytes(record_id), "expires_at_ms": int(expires_at_ms)}:
            recorded.add(record_id)
            if expires_at_ms <= now_ms:
                erased.add(record_id)
        case "access.requested", {"access_id": bytes(access_id)}:
            granted.add(access_id)
        case "erasure.requested", {"records": list(records), "frames": []}:
            erased.update(records)
        case _:
            pass
