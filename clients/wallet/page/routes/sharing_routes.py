"""Routes for sharing and revoking."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from aiohttp import web

from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.page_answers import accepted, answer_json, body_of, language_of, route
from clients.wallet.page.request_fields import RequestFields
from clients.wallet.page.session import PageSession
from clients.wallet.page.wallet_snapshot import Snapshot
from clients.wallet.presentation.share_text import explain, extend_with_grants, made_share
from clients.wallet.records.rights_requests import choose
from clients.wallet.sharing.outgoing_shares import (
    Grantee,
    SharingClient,
    place_end,
    require_purpose_to_share,
    select_shareable,
    share_each,
)
from clients.wallet.text_catalogue import refusal
from pages.local_page import LocalRoute


def routes(session: PageSession) -> list[LocalRoute]:
    return [
        route(session, "POST", "/api/shares/plan", _plan),
        route(session, "POST", "/api/shares", _share),
        route(session, "POST", "/api/shares/{grant}/revoke", _revoke),
    ]


@dataclass(frozen=True, slots=True)
class ShareRequest:
    """A sharing request from the page."""

    records: list[str]
    visits: list[str]
    wanted: str
    label: str
    purpose: str
    until_ms: int

    async def find(self, wallet: Wallet, snapshot: Snapshot) -> tuple[SharingClient, Grantee, list[RecordEntry]]:
        """Raises as the command."""
        require_purpose_to_share(self.purpose, wallet.genesis.purposes)
        sharing = SharingClient(wallet)
        grantee = await sharing.resolve_grantee(self.wanted, self.label)
        reports = [part.report for part in snapshot.visits]
        return sharing, grantee, select_shareable(reports, choose(reports, self.records, self.visits), self.purpose)


def _read_wish(asked: RequestFields, now_ms: int) -> ShareRequest:
    visit = asked.text("visit", "", max_chars=66)
    return ShareRequest(
        records=asked.texts("records"),
        visits=[visit] if visit else [],
        wanted=asked.text("with", max_chars=200),
        label=asked.text("name", "", max_chars=100),
        purpose=asked.text("purpose", max_chars=64),
        until_ms=place_end(asked.number("until_ms"), now_ms),
    )


async def _plan(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    wish = _read_wish(asked, session.now_ms())
    asked.end()
    async with session.hold() as wallet:
        _, grantee, entries = await wish.find(wallet, session.snapshot)
    lines = explain(entries, grantee, wish.purpose, wish.until_ms).split("\n")
    return answer_json(
        {
            "grantee": {
                "handle": grantee.member.handle.hex(),
                "name": grantee.label or None,
                "role": grantee.member.role,
                "organisation": grantee.member.org,
            },
            "records": len(entries),
            "pictures": sum(entry.pictures_left_count for entry in entries),
            "until_ms": wish.until_ms,
            "lines": [line.strip() for line in lines if line.strip()],
        }
    )


async def _share(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    passphrase = asked.text("passphrase")
    wish = _read_wish(asked, session.now_ms())
    asked.end()
    await session.gate.require(passphrase)
    add_made = functools.partial(extend_with_grants, language=language_of(request))

    async def work(job: Job) -> Result:
        await session.read(fresh=True)
        sharing, grantee, entries = await wish.find(session.wallet, session.snapshot)
        done = await share_each(sharing, entries, grantee, wish.purpose, wish.until_ms, job.tell, explain=add_made)
        count = sum(len(shared.records) for shared in done)
        return {"shared": [made_share(shared) for shared in done], "sentence": f"{count} records are shared."}

    return accepted(session.jobs.start("share", work))


async def _revoke(session: PageSession, request: web.Request) -> web.Response:
    grant_id = request.match_info["grant"].lower()
    found = [share for share in session.snapshot.shares() if share.grant.grant_id.hex() == grant_id]
    if not found:
        raise refusal("NOT_FOUND", "share_none")

    async def work(job: Job) -> Result:
        job.tell("writing it into the ledger")
        txid = await SharingClient(session.wallet).revoke(found[0])
        return {"txid": txid.hex(), "looks": len(found[0].looks), "sentence": "This share is ended."}

    return accepted(session.jobs.start("revoke", work))
