"""Requested erasures and their custodians, in words and as answers."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from clients.wallet.answers.record_answers import CustodianAnswer, ErasureRow
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.translations import text
from clients.wallet.records.erasure_status import CustodianStatus, ErasureProgress
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE
from pages.time_format import format_time

REMAINS_NOTHING = "nothing"
_REMAINS = {"commitment-leaves": "erasures.leaves"}
"""What custodians say of what remains, as the ledger has it, and the text for it."""


def custodian_names(wallet: Wallet, language: str = DEFAULT_LANGUAGE) -> dict[bytes, str]:
    say = functools.partial(text, "custodian.named", language=language)
    return {each.key: say(name=each.name, organisation=each.organisation) for each in wallet.network.known_custodians}


def _named(one: CustodianStatus, names: Mapping[bytes, str], language: str | None) -> str:
    return names.get(one.key) or text("custodian.unnamed", language=language, key=one.key.hex()[:12])


def erasure_row(erasure: ErasureProgress, names: Mapping[bytes, str]) -> ErasureRow:
    return ErasureRow(
        erasure_id=erasure.report.erasure_id.hex(),
        visit=erasure.report.visit.owner.hex(),
        asked_at_ms=erasure.asked_at_ms,
        records=erasure.records_count,
        frames=list(erasure.frames),
        status=erasure.report.state.status,
        custodians=[
            CustodianAnswer(
                name=_named(word, names, DEFAULT_LANGUAGE),
                confirmed_at_ms=word.confirmed_at_ms,
                destroyed_frames=word.destroyed_frames,
                remains=word.remains,
                remains_until_ms=word.remains_until_ms,
                overdue=word.overdue,
            )
            for word in erasure.custodians
        ],
    )


def erasure_lines(erasure: ErasureProgress, names: Mapping[bytes, str], language: str | None = None) -> list[str]:
    say = functools.partial(text, language=language)
    what = say("count.records", count=erasure.records_count)
    if erasure.frames:
        what = say("erasures.pictures", count=len(erasure.frames))
    state = say("erasures.complete" if erasure.report.complete else "erasures.waiting")
    lines = [say("erasures.line", moment=format_time(erasure.asked_at_ms), what=what, state=state)]
    for word in erasure.custodians:
        name = _named(word, names, language)
        if word.confirmed_at_ms is not None:
            moment = format_time(word.confirmed_at_ms)
            confirmed = functools.partial(say, name=name, moment=moment, count=word.destroyed_frames)
            if word.remains and word.remains != REMAINS_NOTHING:
                remains = say(_REMAINS[word.remains]) if word.remains in _REMAINS else word.remains
                line = confirmed("erasures.confirmed_but", remains=remains, until=format_time(word.remains_until_ms))
            else:
                line = confirmed("erasures.confirmed")
        else:
            line = say("erasures.overdue" if word.overdue else "erasures.not_yet", name=name)
        lines.append(f"  {line}")
    return lines
