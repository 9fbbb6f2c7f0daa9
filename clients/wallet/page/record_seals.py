"""Record seals: results of earlier checks and their block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from clients.sdk.terminal.json_answers import Answer, Hex
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.translations import describe_error, text
from clients.wallet.records.viewing import CHECKS, STATUS_ERASED, STATUS_NOTICE, STATUS_OK, RecordView, name_places
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256


@dataclass(frozen=True, slots=True)
class VerifiedBlock:
    """The newest block this wallet verified as final."""

    height: int
    time_ms: int
    block_id: bytes


@dataclass(frozen=True, slots=True)
class Seal:
    """A record as found, with block and local time of checking; `verdict_height`: its on-chain verdict's block."""

    view: RecordView
    block: VerifiedBlock
    checked_at_ms: int
    verdict_height: int | None = None


class PageCheck(Answer, frozen=True, kw_only=True):
    """A check of a record."""

    code: str
    ok: bool
    sentence: str


class PageRefusal(Answer, frozen=True, kw_only=True):
    """A custodian that refused."""

    name: str
    code: str
    sentence: str


class PageSeal(Answer, frozen=True, kw_only=True):
    """A seal."""

    record_id: Hex
    state: str
    sentence: str
    checks: list[PageCheck]
    frames_ok: int
    frames_shown: int
    frames_counted: int
    frames_committed: int
    corrupted: list[int]
    damaged: list[int]
    erased: list[int]
    custodians: list[str]
    refused: list[PageRefusal]
    record_height: int
    record_txid: Hex
    proved_height: int
    proved_block_id: Hex
    proved_time_ms: int
    checked_at_ms: int
    verdict_height: int | None


def verified_block(wallet: Wallet) -> VerifiedBlock:
    client = wallet.network.light_client
    return VerifiedBlock(client.header.height, client.header.timestamp_ms, sha256(client.pinned_header_bytes))


def page_seal(seal: Seal, language: str | None = None) -> PageSeal:
    view = seal.view
    state = view.entry.state
    shown = [frame for frame in view.frames if frame.status not in {STATUS_NOTICE, STATUS_ERASED}]
    good = sum(frame.status == STATUS_OK for frame in shown)
    return PageSeal(
        record_id=view.entry.record_id.hex(),
        state="good" if view.verdict == "verified" else "bad",
        sentence=_sentence(view, good, len(shown), language),
        checks=_checks(view, language),
        frames_ok=good,
        frames_shown=len(shown),
        frames_counted=view.frames_counted,
        frames_committed=len(view.frames),
        corrupted=view.corrupted,
        damaged=view.damaged,
        erased=[frame.index for frame in view.frames if frame.status == STATUS_ERASED],
        custodians=list(view.custodians),
        refused=[
            PageRefusal(name=name, code=code, sentence=describe_error(BlockRobotError(code), language)[0])
            for name, code in view.refused
        ],
        record_height=state.height,
        record_txid=state.txid.hex(),
        proved_height=seal.block.height,
        proved_block_id=seal.block.block_id.hex(),
        proved_time_ms=seal.block.time_ms,
        checked_at_ms=seal.checked_at_ms,
        verdict_height=seal.verdict_height,
    )


def _sentence(view: RecordView, good: int, shown: int, language: str | None) -> str:
    lines = [text("seal.whole", language=language, whole=good, count=shown)]
    if view.corrupted:
        lines.append(text("seal.changed", language=language, places=name_places(view.corrupted)))
    if view.miscounted:
        lines.append(text("seal.wrong.complete", language=language, **_counts(view)) + ".")
    return " ".join(lines)


def _checks(view: RecordView, language: str | None) -> list[PageCheck]:
    """Frame checks only if one failed there or all passed."""
    rows = [("header_votes", ""), ("record_on_chain", "")]
    is_known = True
    for check in CHECKS:
        places = name_places([frame.index for frame in view.frames if frame.failed == check])
        if places or is_known:
            rows.append((check, places))
        is_known = is_known and not places
    found: list[tuple[str, bool, Mapping[str, object]]] = [
        (code, not places, {"places": places}) for code, places in rows
    ]
    found.append(("complete", not view.miscounted, _counts(view)))
    return [
        PageCheck(
            code=code, ok=ok, sentence=text(f"seal.{'check' if ok else 'wrong'}.{code}", language=language, **values)
        )
        for code, ok, values in found
    ]


def _counts(view: RecordView) -> dict[str, int]:
    return {"counted": view.frames_counted, "committed": len(view.frames)}
