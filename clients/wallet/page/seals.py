"""The seal of a record: what was checked against which block, and what came of it. Must never be good by anybody's word.

It adds no check: it tells those that the wallet made when it fetched and opened the record.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from clients.wallet.viewing import STATUS_CORRUPTED, STATUS_ERASED, STATUS_NOTICE, STATUS_OK, RecordView
from clients.wallet.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256


@dataclass(frozen=True, slots=True)
class VerifiedBlock:
    """The newest block that this wallet itself has verified to be final."""

    height: int
    time_ms: int
    block_id: bytes


def verified_block(wallet: Wallet) -> VerifiedBlock:
    """Return the block against whose state the wallet checks now."""
    client = wallet.network.light_client
    return VerifiedBlock(client.header.height, client.header.timestamp_ms, sha256(client.pinned_header_bytes))


def seal_json(view: RecordView, block: VerifiedBlock, now_ms: int, verdict_height: int | None = None) -> dict[str, Any]:
    """Return the seal of a record as it was found, checked at `now_ms` by this machine's clock.

    `verdict_height` is the block in which the verdict stands that was put on the chain.
    """
    state = view.entry.state
    shown = [frame for frame in view.frames if frame.status not in {STATUS_NOTICE, STATUS_ERASED}]
    good = sum(frame.status == STATUS_OK for frame in shown)
    is_good = not view.corrupted
    return {
        "record_id": view.entry.record_id.hex(),
        "state": "good" if is_good else "bad",
        "sentence": f"{good} of {len(shown)} pictures are as the robot took them."
        + ("" if is_good else f" Changed since: {', '.join(map(str, view.corrupted))}."),
        "checks": _checks(view),
        "frames_ok": good,
        "frames_shown": len(shown),
        "corrupted": view.corrupted,
        "erased": [frame.index for frame in view.frames if frame.status == STATUS_ERASED],
        "custodians": list(view.custodians),
        "refused": [
            {"name": name, "code": code, "sentence": BlockRobotError(code).detail} for name, code in view.refused
        ],
        "record_height": state.get("height"),
        "record_txid": state["txid"].hex() if "txid" in state else None,
        "proved_height": block.height,
        "proved_block_id": block.block_id.hex(),
        "proved_time_ms": block.time_ms,
        "checked_at_ms": now_ms,
        "verdict_height": verdict_height,
    }


def _checks(view: RecordView) -> list[dict[str, Any]]:
    """Tell what was checked. The first ones hold for all that got so far: else there would be nothing to show."""
    frames_count = view.entry.metadata.frame_count
    bad = [frame.index for frame in view.frames if frame.status == STATUS_CORRUPTED]
    rows = (
        ("header_votes", True, "The block is signed by a quorum of the network's producers"),
        ("record_on_chain", True, "The record stands in that block's state, under the key of your visit"),
        ("ciphertext", not bad, "What was sent is what the ledger names"),
        ("decrypted", not bad, "It opens with your key"),
        ("commitment", not bad, "Every picture is the one that the robot committed to"),
        ("complete", len(view.frames) == frames_count, "No picture is missing"),
    )
    places = ", ".join(map(str, bad))
    wrong = (
        f"Pictures {places} did not pass at any custodian." if bad else f"{len(view.frames)} of {frames_count} came."
    )
    return [{"code": code, "ok": ok, "what": what, "sentence": f"{what}." if ok else wrong} for code, ok, what in rows]
