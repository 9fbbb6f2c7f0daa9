"""Shares, made and received, in words and as answers."""

from __future__ import annotations

import functools
from collections.abc import Sequence

from clients.wallet.answers.sharing_answers import (
    GranteeLook,
    MadeShare,
    OwnShare,
    ReceivedShare,
    ShareNotice,
    UnreadShare,
    VisitAlarm,
)
from clients.wallet.ledger.wallet import RecordEntry, VisitReport
from clients.wallet.presentation.translations import (
    code_text,
    describe_error,
    text,
)
from clients.wallet.sharing.inbox import copies_left
from clients.wallet.sharing.incoming_shares import (
    IncomingShare,
    UnreadableGrant,
)
from clients.wallet.sharing.outgoing_shares import (
    FinalGrant,
    Grantee,
    Share,
)
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.members.vouchers import ROLES
from consensus.rights.purposes import PURPOSES, require_purpose
from pages.time_format import format_time


def role_text(role: str) -> str:
    return text(f"role.{role}") if role in ROLES else role


def name_grantee(grantee: Grantee) -> str:
    return text(
        "share.grantee",
        name=grantee.label or text("share.nobody"),
        role=role_text(grantee.member.role),
        organisation=grantee.member.org,
        handle=encode_short(grantee.member.handle),
    )


def name_recipient(share_: Share, language: str | None = None) -> str:
    given = share_.given
    if given is None:
        return text("shares.forgotten", language=language)
    start = encode_short(given.handle)
    if not given.label:
        return text("shares.member", language=language, handle=start)
    return text("shares.named", language=language, label=given.label, handle=start)


def explain(entries: Sequence[RecordEntry], grantee: Grantee, purpose: str, until_ms: int) -> str:
    """Raises PURPOSE_UNKNOWN."""
    require_purpose(purpose)
    pictures = sum(entry.pictures_left_count for entry in entries)
    gone = sum(entry.state.expires_at_ms < until_ms for entry in entries)
    return text(
        "share.plan",
        records=text("count.records", count=len(entries)),
        things=text("count.pictures_and_sounds", count=pictures),
        sensors=", ".join(code_text("sensor", code) for code in sorted({each.metadata.sensor for each in entries})),
        first=format_time(min(entry.metadata.started_at_ms for entry in entries)),
        last=format_time(max(entry.metadata.ended_at_ms for entry in entries)),
        grantee=name_grantee(grantee),
        purpose=purpose,
        meaning=text(f"purpose.{purpose}"),
        until=format_time(until_ms),
        early=text("share.early", count=gone) if gone else "",
    )


def made_share(shared: FinalGrant) -> MadeShare:
    return MadeShare(
        grant_id=shared.grant_id.hex(),
        visit=shared.visit.owner.hex(),
        records=[record_id.hex() for record_id in shared.records],
        left_out=[record_id.hex() for record_id in shared.left_out],
        until_ms=shared.until_ms,
        pictures=shared.pictures_count,
        custodians=list(shared.custodians),
        custodians_away=list(shared.absent),
    )


def extend_with_grants(error: BlockRobotError, done: Sequence[FinalGrant], language: str) -> BlockRobotError:
    """Each completed grant holds up to 64 records."""
    if not done:
        return error
    names = ", ".join(shared.grant_id.hex()[:12] for shared in done)
    count = sum(len(shared.records) for shared in done)
    detail = text("share.partly", language=language, count=count, names=names, why=error.detail)
    return BlockRobotError(error.code, detail)


def own_share(share_: Share, now_ms: int) -> OwnShare:
    grant, given = share_.grant, share_.given
    return OwnShare(
        grant_id=grant.grant_id.hex(),
        visit=share_.visit.owner.hex(),
        records=[record_id.hex() for record_id in grant.row.records],
        handle=None if given is None else given.handle.hex(),
        name=None if given is None else given.label or None,
        purpose=grant.row.purpose,
        shared_at_ms=grant.row.time,
        until_ms=grant.row.until_ms,
        status=_status(share_, now_ms),
        looks=[
            GranteeLook(time_ms=look.time_ms, records=look.records_count, custodians_released=look.released_count)
            for look in share_.looks
        ],
        confirmed_deleted=[record_id.hex() for record_id in grant.row.records if record_id in share_.confirmed],
        cut=[record_id.hex() for record_id in grant.row.records if record_id in share_.cut],
        erased=[record_id.hex() for record_id in grant.row.records if record_id in share_.erased],
    )


def _status(share_: Share, now_ms: int) -> str:
    if share_.grant.row.is_open(now_ms):
        return "open"
    return "revoked" if share_.grant.row.status == "revoked" else "over"


def share_lines(share_: Share, now_ms: int) -> list[str]:
    grant, until, status = share_.grant, format_time(share_.grant.row.until_ms), _status(share_, now_ms)
    ends = {
        "open": text("shares.open", until=until),
        "over": text("shares.over", until=until),
        "revoked": text("shares.revoked"),
    }
    lines = [
        text(
            "shares.line",
            grant=grant.grant_id.hex()[:12],
            records=text("count.records", count=len(grant.row.records)),
            visit=share_.visit.owner.hex()[:12],
            name=name_recipient(share_),
            purpose=code_text("purpose", grant.row.purpose),
            end=text("shares.nothing_left") if status == "open" and not share_.left else ends[status],
        )
    ]
    if share_.erased:
        lines.append("  " + text("shares.erased", count=len(share_.erased)))
    if share_.cut:
        lines.append("  " + text("shares.cut", count=len(share_.cut)))
    for look in share_.looks:
        key = "shares.ready" if look.released_count else "shares.asked"
        lines.append("  " + text(key, moment=format_time(look.time_ms), count=look.records_count))
    if not share_.looks:
        lines.append("  " + text("shares.no_looks"))
    if share_.confirmed:
        lines.append("  " + text("shares.deleted", count=len(share_.confirmed)))
    return lines


def received_share(share: IncomingShare) -> ReceivedShare:
    grant = share.grant
    return ReceivedShare(
        grant_id=grant.grant_id.hex(),
        visit=grant.row.owner.hex(),
        records=[record_id.hex() for record_id in grant.row.records],
        purpose=grant.row.purpose,
        shared_at_ms=grant.row.time,
        until_ms=grant.row.until_ms,
        open=share.is_open,
        looked=share.looked,
        to_look=[record_id.hex() for record_id in share.to_look],
        notices=[
            ShareNotice(record_id=notice.record_id.hex(), kind=notice.kind, confirmed=notice.confirmed)
            for notice in share.notices
        ],
        to_confirm=[record_id.hex() for record_id in share.to_confirm],
        copies=[str(place) for place in copies_left(share, grant.row.records)],
    )


def incoming_share_lines(share: IncomingShare, language: str | None = None) -> list[str]:
    say = functools.partial(text, language=language)
    grant, name = share.grant, share.grant.grant_id.hex()[:12]
    records = say("count.records", count=len(grant.row.records))
    end = say("received.open", until=format_time(grant.row.until_ms)) if share.is_open else say("received.over")
    meaning = say(f"purpose.{grant.row.purpose}") if grant.row.purpose in PURPOSES else grant.row.purpose
    visit = grant.row.owner.hex()[:12]
    lines = [say("received.line", grant=name, records=records, visit=visit, end=end, purpose=meaning)]
    news = [notice for notice in share.notices if not notice.confirmed]
    # Who never looked has no copy.
    words = "received.had" if share.looked else "received.never_had"
    for kind in dict.fromkeys(notice.kind for notice in news):
        same_kind = [notice for notice in news if notice.kind == kind]
        what = say(f"{words}.{kind}", count=len(same_kind))
        lines.append("  " + say("received.news", number=len(same_kind), records=records, what=what))
        if len(same_kind) < len(grant.row.records):
            lines += [f"    {notice.record_id.hex()}" for notice in same_kind]
    lines += ["  " + say("received.copy", place=place) for place in copies_left(share, share.to_confirm)]
    if share.to_confirm and not share.looked:
        lines.append("  " + say("received.never"))
    elif share.to_confirm:
        lines.append("  " + say("received.confirm", grant=name))
    elif len(news) < len(share.notices):
        lines.append("  " + say("received.confirmed"))
    if share.to_look:
        lines.append("  " + say("received.look", grant=name))
    return lines


def unread_share(unread: UnreadableGrant) -> UnreadShare:
    error = unread.error
    return UnreadShare(grant_id=unread.received.grant_id.hex(), code=error.code, detail=error.detail)


def unread_line(unread: UnreadableGrant, language: str | None = None) -> str:
    why, _ = describe_error(unread.error, language)
    return text("received.unread", language=language, grant=unread.received.grant_id.hex()[:12], why=why)


def visit_alarm(report: VisitReport) -> VisitAlarm:
    return VisitAlarm(
        visit=report.visit.owner.hex(),
        missing_records=report.missing_count,
        unreadable_records=[record_id.hex() for record_id in report.unreadable_ids],
    )
