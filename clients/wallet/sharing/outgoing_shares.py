"""Shares records with one staff member or officer, and revokes shares.

The visit's owner key signs; the chain learns neither owner nor grantee.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from clients.sdk.chain.proved_rows import proved_row, put_query
from clients.sdk.connections import NodeAddress
from clients.sdk.node_answers import SURE_REFUSALS
from clients.sdk.quorum import require_quorum
from clients.wallet.ledger.visit_audit import AuditEntry, audit_visit
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.records.rights_requests import RecordChoice
from clients.wallet.records.viewing import RecordViewer
from clients.wallet.sharing.chain_grants import Grant, cut_since, read_custodians, read_grants
from clients.wallet.store.keystore import GivenGrant, KnownVisit
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.members.handles import decode_short, encode_short, is_short
from consensus.primitives.keys import PrivateKey
from consensus.records.sharing import (
    GRANT_MAX_MS,
    GRANT_RECORDS_MAX_COUNT,
    GRANT_STEP_MS,
    GRANTEE_ROLES,
    SHARE_KEY_BYTES,
    GrantUpload,
    count_masks,
    derive_grant_salt,
    hash_grant_member,
    open_grant_keys,
    seal_package,
    split_share_key,
)
from consensus.state.access import REQUEST, AccessRow
from consensus.state.audit import COUNT
from consensus.state.identity import REMOVED, MemberRow, handle_from, member_with, role_now
from consensus.state.records import RECORD

HANDLE_BYTES = 32
OWN_ACCESS = "own-access"
GRANT_LIFETIME_MS = 5 * 60_000
"""How long the grant's transaction may take, with the uploads before it."""
UPLOADED_MIN_COUNT = 2
UPLOAD_ATTEMPTS_MAX_COUNT = 20
UPLOAD_PAUSE_S = 0.25
STEP_KEYS = "fetching the keys"
STEP_PARTS = "handing its parts to "
STEP_SIGNING = "signing"
"""The steps of the work by name; what shows them translates them."""
_NOT_YET = frozenset({"CLIP_NOT_CONFIRMED", "CUSTODY_CATCHING_UP", "RATE_LIMITED"})
"""What a custodian says that follows the chain a moment late, or has too much to do."""
_NONCE_BYTES = 24
_GONE = ("erasing", "erased")
OnProgress = Callable[[str], None]
Sleep = Callable[[float], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class Grantee:
    """A grantee as proven by the chain, with the owner's label."""

    label: str
    member: MemberRow


@dataclass(frozen=True, slots=True)
class FinalGrant:
    """A final grant; `pictures_count` can be opened, `custodians` hold parts."""

    grant_id: bytes
    visit: KnownVisit
    records: tuple[bytes, ...]
    until_ms: int
    pictures_count: int
    left_out: tuple[bytes, ...]
    custodians: tuple[str, ...]
    absent: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class GranteeRequest:
    """One grantee request: when, records requested and custodians ready."""

    time_ms: int
    records_count: int
    released_count: int


@dataclass(frozen=True, slots=True)
class Share:
    """One of the owner's grants, proven; `given` is this wallet's note.

    `confirmed`: copies reported deleted; `cut`: partly erased; `erased`: wholly.
    """

    grant: Grant
    visit: KnownVisit
    given: GivenGrant | None
    looks: tuple[GranteeRequest, ...]
    confirmed: frozenset[bytes]
    cut: frozenset[bytes]
    erased: frozenset[bytes] = frozenset()

    def shows(self, record_id: bytes, now_ms: int) -> bool:
        return self.grant.row.is_open(now_ms) and record_id in self.left

    @property
    def left(self) -> list[bytes]:
        return [record_id for record_id in self.grant.row.records if record_id not in self.cut | self.erased]


def _same_name(label: str, name: str) -> bool:
    return bool(label) and label.strip().casefold() == name.strip().casefold()


def require_purpose_to_share(purpose: str, known: Sequence[str]) -> None:
    """Raise SHARE_NOT_POSSIBLE."""
    if purpose not in known or purpose == OWN_ACCESS:
        free = ", ".join(code for code in known if code != OWN_ACCESS)
        raise refusal("SHARE_NOT_POSSIBLE", "share_purpose", purpose=purpose, free=free)


def place_end(until_ms: int, now_ms: int) -> int:
    """Round up to five minutes. Raises SHARE_NOT_POSSIBLE for the past or beyond 366 days."""
    end_ms = -(-until_ms // GRANT_STEP_MS) * GRANT_STEP_MS
    if not now_ms < end_ms <= now_ms + GRANT_MAX_MS:
        raise refusal("SHARE_NOT_POSSIBLE", "share_until")
    return end_ms


def select_shareable(reports: Sequence[VisitReport], chosen: Sequence[RecordChoice], purpose: str) -> list[RecordEntry]:
    """Return the shareable records of one visit.

    Raises SHARE_NOT_POSSIBLE for several visits (grants would link them), NOTHING_TO_SHARE, CALL_REFUSED (the chain's
    code).
    """
    if len(chosen) != 1:
        raise refusal("SHARE_NOT_POSSIBLE", "share_one_visit")
    (report,) = [each for each in reports if each.visit.owner == chosen[0].visit.owner]
    rights = report.rights
    entries = [entry for entry in chosen[0].records or report.records if entry.state.status == "active"]
    if rights.breach_id:
        raise BlockRobotError("CALL_REFUSED", "VISIT_QUARANTINED: You denied this visit: nobody sees it.")
    if purpose in rights.objections:
        raise BlockRobotError("CALL_REFUSED", f"PURPOSE_OBJECTED: You objected to any release of it for {purpose}.")
    if any(rights.restricts(entry.record_id) for entry in entries):
        raise BlockRobotError(
            "CALL_REFUSED", "RECORD_RESTRICTED: You restricted it: only you see it, until you lift that."
        )
    if not entries:
        raise refusal("NOTHING_TO_SHARE", "share_nothing")
    return entries


class SharingClient:
    """Sharing of one owner's records."""

    def __init__(
        self,
        wallet: Wallet,
        *,
        viewing: RecordViewer | None = None,
        draw: Callable[[int], bytes] = secrets.token_bytes,
        sleep: Sleep = asyncio.sleep,
    ) -> None:
        self._wallet = wallet
        self._viewing = viewing or RecordViewer(wallet)
        self._draw = draw
        self._sleep = sleep

    async def resolve_grantee(self, wanted: str, label: str = "") -> Grantee:
        """Return the member with this handle (short, or 64 hex digits) or label, by quorum in the member session.

        Raises SHARE_WITH_NON_MEMBER (no active staff or officer), SHARE_NOT_POSSIBLE (bad, ambiguous or taken),
        QUORUM_UNREACHABLE.
        """
        handle, known = await self._read_handle(wanted)
        label = label.strip()
        for other in self._called(label) - {handle}:
            raise refusal("SHARE_NOT_POSSIBLE", "share_named", name=label, handle=encode_short(other))
        wallet, session = self._wallet, self._wallet.keys.identity
        await wallet.require_registered()
        await require_quorum(wallet.network, session)
        if handle == wallet.store.content.handle:
            raise refusal("SHARE_NOT_POSSIBLE", "share_self")
        read = wallet.reading(session)
        member = await put_query(read, lambda state: member_with(state, handle))
        if member is None or not member.is_active or member.handle != handle:
            raise refusal("SHARE_WITH_NON_MEMBER", "share_nobody")
        if member.role not in GRANTEE_ROLES:
            raise refusal("SHARE_WITH_NON_MEMBER", "share_role", role=member.role)
        removed_ms = await proved_row(read, REMOVED, member.org)
        if not role_now(member, removed_ms):
            raise refusal("SHARE_WITH_NON_MEMBER", "share_left", organisation=member.org)
        return Grantee(label or known, member)

    async def _read_handle(self, wanted: str) -> tuple[bytes, str]:
        called = self._called(wanted)
        if len(called) > 1:
            starts = ", ".join(sorted(map(encode_short, called)))
            raise refusal("SHARE_NOT_POSSIBLE", "share_several", name=wanted, handles=starts)
        for given in reversed(self._wallet.store.content.given_grants):
            if given.handle in called and _same_name(given.label, wanted):
                return given.handle, given.label
        try:
            handle = (
                await self._of_short(wanted)
                if is_short(wanted)
                else bytes.fromhex("".join(wanted.replace("-", "").split()))
            )
        except ValueError:
            handle = b""
        if len(handle) != HANDLE_BYTES:
            raise refusal("SHARE_NOT_POSSIBLE", "share_handle", given=wanted)
        known = [given.label for given in self._wallet.store.content.given_grants if given.handle == handle]
        return handle, known[-1] if known else ""

    async def _of_short(self, wanted: str) -> bytes:
        """Raises HANDLE_MISTYPED and SHARE_WITH_NON_MEMBER."""
        short = decode_short(wanted)
        await self._wallet.require_registered()
        read = self._wallet.reading(self._wallet.keys.identity)
        handle = await put_query(read, partial(handle_from, start=short))
        if handle is None:
            raise refusal("SHARE_WITH_NON_MEMBER", "share_nobody")
        return handle

    def _called(self, name: str) -> set[bytes]:
        return {given.handle for given in self._wallet.store.content.given_grants if _same_name(given.label, name)}

    async def share(
        self, entries: Sequence[RecordEntry], grantee: Grantee, purpose: str, until_ms: int, on_progress: OnProgress
    ) -> FinalGrant:
        """Share up to 64 records of one visit and wait for finality; `until_ms` is a full five minutes.

        Records without an openable picture are omitted. Raises SHARE_CUSTODIANS_MISSING, NOTHING_TO_SHARE,
        CALL_REFUSED.
        """
        if not 1 <= len(entries) <= GRANT_RECORDS_MAX_COUNT:
            raise refusal("SHARE_NOT_POSSIBLE", "share_records", most=GRANT_RECORDS_MAX_COUNT)
        visit = entries[0].visit
        custodians = await self._get_custodians()
        on_progress(STEP_KEYS)
        data_keys = await self._open_keys(entries)
        records = [entry.record_id for entry in entries if data_keys[entry.record_id]]
        if not records:
            raise refusal("NOTHING_TO_SHARE", "share_unopened")
        chain_id = self._wallet.genesis.chain_id
        ephemeral = PrivateKey(self._draw(32))
        to = grantee.member
        made = open_grant_keys(ephemeral.secret, to.view, to.spend, chain_id=chain_id, owner=visit.owner)
        salt = derive_grant_salt(ephemeral, to.view, chain_id=chain_id, owner=visit.owner)
        hidden = hash_grant_member(salt, to.handle)
        key, network = self._wallet.owner_key(visit), self._wallet.network
        arguments = [records, made.owner, made.ephemeral, made.view_tag, hidden, purpose, until_ms]
        transaction = network.transactions.build(key, "access", "grant", arguments, lifetime_ms=GRANT_LIFETIME_MS)
        uploads = [
            upload
            for record_id in records
            for upload in self._make_uploads(
                (transaction.txid, transaction.body.valid_until_ms, record_id),
                to.sealing,
                made.owner,
                data_keys[record_id],
                list(custodians),
            )
        ]
        held, absent = await self._upload_all(uploads, custodians, key, on_progress)
        on_progress(STEP_SIGNING)
        self._remember(GivenGrant(transaction.txid, visit.owner, to.handle, grantee.label, salt))
        try:
            (await network.submit_and_wait(transaction)).require_ok()
        except BlockRobotError as error:
            if error.code in SURE_REFUSALS:
                self._forget(transaction.txid)
            raise
        left_out = tuple(entry.record_id for entry in entries if entry.record_id not in records)
        pictures = sum(len(data_keys[record_id]) for record_id in records)
        return FinalGrant(transaction.txid, visit, tuple(records), until_ms, pictures, left_out, held, absent)

    async def _open_keys(self, entries: Sequence[RecordEntry]) -> dict[bytes, dict[int, bytes]]:
        access_id = await self._viewing.request_access(list(entries), OWN_ACCESS)
        found = {}
        for entry in entries:
            view = await self._viewing.view(entry, access_id)
            found[entry.record_id] = {frame.index: frame.data_key for frame in view.frames if frame.data_key}
        return found

    async def _get_custodians(self) -> dict[bytes, NodeAddress | None]:
        """Raises QUORUM_UNREACHABLE and SHARE_CUSTODIANS_MISSING."""
        await require_quorum(self._wallet.network, self._wallet.keys.identity)
        custodians = await read_custodians(self._wallet, self._wallet.keys.identity)
        if not custodians:
            raise BlockRobotError("SHARE_CUSTODIANS_MISSING", "The chain names no custodian.")
        return custodians

    def _make_uploads(
        self,
        place: tuple[bytes, int, bytes],
        sealing: bytes,
        grantee: bytes,
        data_keys: dict[int, bytes],
        custodians: list[bytes],
    ) -> list[tuple[bytes, GrantUpload]]:
        txid, valid_until_ms, record_id = place
        share_key = self._draw(SHARE_KEY_BYTES)
        masks = [self._draw(SHARE_KEY_BYTES) for _ in range(count_masks(len(custodians)))]
        package = seal_package(
            share_key, self._draw(_NONCE_BYTES), sealing, grantee=grantee, record_id=record_id, keys=data_keys
        )
        parts = split_share_key(share_key, custodians, masks)
        return [(key, GrantUpload(txid, valid_until_ms, record_id, package, parts[key])) for key in custodians]

    async def _upload_all(
        self,
        uploads: Sequence[tuple[bytes, GrantUpload]],
        custodians: dict[bytes, NodeAddress | None],
        key: PrivateKey,
        on_progress: OnProgress,
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return who stored all and who is absent. Raises SHARE_CUSTODIANS_MISSING unless two have all parts, or the only
        one has.
        """
        held, absent, failures = [], [], []
        for custodian, node in custodians.items():
            name = f"custodian {custodian.hex()[:12]}" if node is None else node.name
            on_progress(STEP_PARTS + name)
            try:
                if node is None:
                    raise BlockRobotError("NODE_UNREACHABLE", f"The address of {name} is not known here.")
                for upload in (upload for to, upload in uploads if to == custodian):
                    await self._upload(node, upload, key)
            except BlockRobotError as error:
                absent.append(name)
                failures.append(f"{name} ({error.code})")
            else:
                held.append(name)
        needed = min(UPLOADED_MIN_COUNT, len(custodians))
        if len(held) < needed:
            counts = {"held": len(held), "count": len(custodians), "needed": needed}
            raise refusal("SHARE_CUSTODIANS_MISSING", "share_parts", **counts, absent=", ".join(failures))
        return tuple(held), tuple(absent)

    async def _upload(self, node: NodeAddress, upload: GrantUpload, key: PrivateKey) -> None:
        for _ in range(UPLOAD_ATTEMPTS_MAX_COUNT - 1):
            try:
                return await self._wallet.network.custody.upload_grant(node, upload, key)
            except BlockRobotError as error:
                if error.code not in _NOT_YET:
                    raise
            await self._sleep(UPLOAD_PAUSE_S)
        return await self._wallet.network.custody.upload_grant(node, upload, key)

    def _remember(self, given: GivenGrant) -> None:
        self._wallet.store.content.given_grants.append(given)
        self._wallet.store.save()

    def _forget(self, grant_id: bytes) -> None:
        content = self._wallet.store.content
        content.given_grants = [given for given in content.given_grants if given.grant_id != grant_id]
        self._wallet.store.save()

    async def shares(self) -> list[Share]:
        """Oldest first, proven from audit trails."""
        known = {given.grant_id: given for given in self._wallet.store.content.given_grants}
        found: list[Share] = []
        for visit in await self._wallet.scan():
            found += await self._shares_of(visit, known)
        return sorted(found, key=lambda share: (share.grant.row.time, share.grant.grant_id))

    async def shares_of(self, visit: KnownVisit) -> list[Share]:
        return await self._shares_of(
            visit, {given.grant_id: given for given in self._wallet.store.content.given_grants}
        )

    async def _shares_of(self, visit: KnownVisit, known: dict[bytes, GivenGrant]) -> list[Share]:
        trail = await audit_visit(self._wallet, visit)
        ids = [entry.data["grant_id"] for entry in trail if entry.kind == "granted"]
        if not ids:
            return []
        key = self._wallet.owner_key(visit)
        grants = await read_grants(self._wallet, ids, key)
        looks = [entry.data["access_id"] for entry in trail if _is_grantee_request(entry)]
        shared = sorted({record_id for grant in grants for record_id in grant.row.records})
        values = await self._wallet.values([*map(REQUEST.key, looks), *map(RECORD.key, shared)], key)
        asked = {access_id: REQUEST.convert(values[REQUEST.key(access_id)]) for access_id in looks}
        rows = {record_id: RECORD.convert(values[RECORD.key(record_id)]) for record_id in shared}
        gone = frozenset(record_id for record_id, row in rows.items() if row.status in _GONE)
        found = []
        for grant in grants:
            erased = gone.intersection(grant.row.records)
            cut = frozenset(cut_since(grant, trail)).intersection(grant.row.records) - erased
            looked, confirmed = (
                find_grantee_requests(trail, grant.grant_id),
                find_confirmed(trail, grant.grant_id, asked),
            )
            found.append(Share(grant, visit, known.get(grant.grant_id), looked, confirmed, cut, erased))
        return found

    async def recipients(self, entries: Sequence[RecordEntry]) -> list[Share]:
        visits = {entry.visit.owner: entry.visit for entry in entries}
        ids = {entry.record_id for entry in entries}
        found = [share for visit in visits.values() for share in await self.shares_of(visit)]
        return [share for share in found if ids.intersection(share.grant.row.records)]

    async def revoke(self, share: Share) -> bytes:
        """Custodians destroy their parts. Returns the txid. Raises CALL_REFUSED (GRANT_ENDED)."""
        return await self._wallet.sign_and_wait(share.visit, "access", "revoke", [share.grant.grant_id])

    async def end_unknown(self, visit: KnownVisit) -> list[bytes]:
        """Open grants unknown to this wallet; return ids. Raises CALL_REFUSED."""
        wallet, key = self._wallet, self._wallet.owner_key(visit)
        state = await wallet.network.state_values([COUNT.key(visit.owner)], key)
        trail = await audit_visit(wallet, visit, COUNT.among(state.values, visit.owner) or 0)
        known = {given.grant_id for given in wallet.store.content.given_grants}
        ids = [entry.data["grant_id"] for entry in trail if entry.kind == "granted"]
        grants = await read_grants(wallet, [grant_id for grant_id in ids if grant_id not in known], key)
        found = [grant.grant_id for grant in grants if grant.row.is_open(state.timestamp_ms)]
        for grant_id in found:
            try:
                await wallet.sign_and_wait(visit, "access", "revoke", [grant_id])
            except BlockRobotError as error:
                if error.context.get("contract_code") != "GRANT_ENDED":
                    raise
        return found


def find_grantee_requests(trail: Sequence[AuditEntry], grant_id: bytes) -> tuple[GranteeRequest, ...]:
    released: dict[bytes, set[Any]] = {}
    for entry in trail:
        if entry.kind == "access_released":
            released.setdefault(entry.data["access_id"], set()).add(entry.data["custodian"])
    return tuple(
        GranteeRequest(entry.time_ms, entry.data["records"], len(released.get(entry.data["access_id"], ())))
        for entry in trail
        if _is_grantee_request(entry) and entry.data["grant"] == grant_id
    )


def _is_grantee_request(entry: AuditEntry) -> bool:
    return entry.kind == "access_requested" and isinstance(entry.data.get("grant"), bytes)


def find_confirmed(trail: Sequence[AuditEntry], grant_id: bytes, asked: Mapping[bytes, AccessRow]) -> frozenset[bytes]:
    """Reported deleted and not requested since; `asked` holds proven request rows by id."""
    gone: set[bytes] = set()
    for entry in trail:
        if entry.kind == "grant_noticed" and entry.data["grant_id"] == grant_id:
            gone.update(entry.data["records"])
        elif _is_grantee_request(entry) and entry.data["grant"] == grant_id:
            gone.difference_update(asked[entry.data["access_id"]].records)
    return frozenset(gone)


async def share_each(
    sharing: SharingClient,
    entries: Sequence[RecordEntry],
    grantee: Grantee,
    purpose: str,
    until_ms: int,
    on_progress: OnProgress,
    *,
    explain: Callable[[BlockRobotError, Sequence[FinalGrant]], BlockRobotError],
) -> list[FinalGrant]:
    """Share in as many grants as needed; `explain` tells in a failure which are made already."""
    done: list[FinalGrant] = []
    for start in range(0, len(entries), GRANT_RECORDS_MAX_COUNT):
        part = entries[start : start + GRANT_RECORDS_MAX_COUNT]
        try:
            done.append(await sharing.share(part, grantee, purpose, until_ms, on_progress))
        except BlockRobotError as error:
            raise explain(error, done) from None
    return done
