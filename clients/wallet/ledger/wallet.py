"""A person's wallet: register, find, list. Each visit is queried in its owner key's session and connection, separate
from the member's, against linking.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from clients.sdk.chain.announcements import AnnouncementPage
from clients.sdk.chain.enrolment import NewMember, Registration, find_registration, register_member
from clients.sdk.chain.proved_rows import Read, in_session, proved_row
from clients.sdk.given_nodes import use_given_nodes
from clients.sdk.network_client import NetworkClient
from clients.wallet.ledger.visit_audit import RECORDED_KIND, AuditEntry, audit_visit
from clients.wallet.ledger.visit_scan import follow_announcements, owner_key
from clients.wallet.ledger.visit_status import VisitRights, read_rights
from clients.wallet.store.kept_proofs import keep_receipt
from clients.wallet.store.keystore import Keystore, KnownVisit
from clients.wallet.store.member_keys import WalletKeys, derive_keys
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.members.vouchers import Card, decode_card_code
from consensus.primitives.encoding import decode
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import open_data_key, open_metadata
from consensus.records.metadata import NOTICE_SENSOR, RecordMetadata, check_metadata, find_chain_gaps
from consensus.rights.purposes import require_published
from consensus.state.audit import COUNT
from consensus.state.identity import MemberRow
from consensus.state.keys import Prefix
from consensus.state.records import CURRENT, RECORD, VISIT, RecordRow, deciding_key
from consensus.state.rights import CORRECTION_COUNT, OBJECTION, QUARANTINE, RESTRICTION

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RecordEntry:
    """A proven, opened record. Times are robot wall-clock milliseconds."""

    record_id: bytes
    visit: KnownVisit
    state: RecordRow
    metadata: RecordMetadata

    @property
    def erased(self) -> bool:
        return self.state.status == "erased"

    @property
    def pictures_count(self) -> int:
        """Originally; 0 for withheld-frame notices."""
        return 0 if self.metadata.sensor == NOTICE_SENSOR else self.metadata.frame_count

    @property
    def pictures_left_count(self) -> int:
        return max(0, self.pictures_count - len(self.state.erased_frames))


@dataclass(frozen=True, slots=True)
class VisitReport:
    """A visit's records in order, with gaps. `unreadable_ids` have wrongly sealed metadata; `trail_count` is the
    audit's length.
    """

    visit: KnownVisit
    records: tuple[RecordEntry, ...]
    erased_ids: tuple[bytes, ...]
    closed: bool
    missing_count: int
    unreadable_ids: tuple[bytes, ...] = ()
    rights: VisitRights = field(default_factory=VisitRights)
    trail_count: int = 0

    @property
    def needs_former_words(self) -> bool:
        """Whether records are sealed to a former mnemonic of a rotated visit."""
        return bool(self.unreadable_ids and self.visit.current)


_LOOK_UP_MS = 2_000
SCAN_SAVED_EVERY_COUNT = 10_000
"""Of announcements or grants that were read; a scan that is cut off goes on from there."""
_CHANGES_NO_RECORD = frozenset(
    {RECORDED_KIND, "visit_closed", "access_requested", "access_released", "access_refused", "verdict", "granted"}
)
"""Kinds of events after which all records that were there before are as they were."""


def _keys_of(visit: KnownVisit) -> list[bytes]:
    kinds: tuple[Prefix[Any], ...] = (VISIT, COUNT, RESTRICTION, OBJECTION, CORRECTION_COUNT, QUARANTINE)
    return [kind.key(visit.owner) for kind in kinds]


def _still_true(before: VisitReport | None, visit: KnownVisit, trail: Sequence[AuditEntry]) -> VisitReport | None:
    """Return the earlier report if its trail shows no change."""
    if before is None or before.visit != visit or before.trail_count > len(trail):
        return None
    return before if all(entry.kind in _CHANGES_NO_RECORD for entry in trail[before.trail_count :]) else None


class Wallet:
    """An open wallet; use as `async with`. `member_gone`: membership ended without leaving; only known visits are
    shown, without `out_of_reach` ones. Setting `trails` to a dict caches audits. `tell_scanned` hears how many were read of
    how many, each time a long scan is saved.
    """

    def __init__(self, store: Keystore, genesis: Genesis) -> None:
        self.store = store
        self.genesis = genesis
        self.load_keys()
        self.network = NetworkClient(genesis, pinned=store.content.pin or None)
        self.member_gone = False
        self.out_of_reach: tuple[KnownVisit, ...] = ()
        self.trails: dict[bytes, list[AuditEntry]] | None = None
        self.tell_scanned: Callable[[int, int], None] = lambda _done, _of: None

    async def __aenter__(self) -> Wallet:
        await use_given_nodes(self.network, self.genesis.chain_id)
        return self

    async def __aexit__(self, *exception: object) -> None:
        self.store.content.pin = self.network.pinned or b""
        self.store.save()
        await self.network.close()

    def load_keys(self) -> None:
        """Derive keys of all mnemonics: `eras`, oldest first, the last current."""
        content = self.store.content
        self.eras: list[WalletKeys] = [derive_keys(words) for words in [*content.former, content.words]]
        self.keys: WalletKeys = self.eras[-1]

    def owner_key(self, visit: KnownVisit) -> PrivateKey:
        """Of the controlling key, as far as known."""
        return owner_key(visit, self.eras[visit.era], self.genesis.chain_id)

    def open_metadata(self, sealed: bytes) -> tuple[bytes, WalletKeys]:
        """Return the metadata and the keys it was sealed to. Raises ENVELOPE_INVALID."""
        return self._with_any(lambda keys: (open_metadata(keys.sealing, sealed), keys))

    def open_data_key(self, sealed: bytes) -> bytes:
        """Raises ENVELOPE_INVALID."""
        return self._with_any(lambda keys: open_data_key(keys.sealing, sealed))

    def _with_any(self, work: Callable[[WalletKeys], T]) -> T:
        for keys in reversed(self.eras[1:]):
            try:
                return work(keys)
            except BlockRobotError:
                continue
        return work(self.eras[0])

    async def register(self, code: str, purposes: list[str]) -> Registration:
        """Consents to `purposes`; idempotent. Raises VOUCHER_INVALID, PURPOSE_UNKNOWN, NOT_PERMITTED."""
        card = decode_card_code(code)
        require_published(purposes, self.genesis.purposes)
        keys = self.keys
        member = NewMember(
            identity=keys.identity,
            spend=keys.spend.public_key,
            view=keys.view.public_key,
            sealing=keys.sealing_public,
        )
        registration = await register_member(self.network, card, member, purposes)
        if registration.receipt is not None:
            keep_receipt(self.store.content, registration.receipt)
        self._remember_registration(card)
        return registration

    async def find_registration(self, keys: WalletKeys) -> MemberRow | None:
        """Proven; None if it is not active."""
        return await find_registration(self.network, keys.identity)

    def _remember_registration(self, member: MemberRow | Card) -> None:
        content = self.store.content
        content.handle, content.role = member.handle, member.role
        content.left, content.leaving = False, []
        self.store.save()

    async def values(self, keys: Sequence[bytes], session: PrivateKey) -> dict[bytes, Any]:
        """Proved; None for absent ones."""
        return await in_session(self.network, session)(keys)

    def reading(self, session: PrivateKey) -> Read:
        return lambda keys: self.values(keys, session)

    async def sign_and_wait(self, visit: KnownVisit, contract: str, entry: str, arguments: list[Any]) -> bytes:
        """With the owner key; return the txid. Keeps erasure proofs. Raises CALL_REFUSED."""
        receipt = await self.network.call(self.owner_key(visit), contract, entry, arguments)
        if contract == "erasure":
            keep_receipt(self.store.content, receipt)
        return receipt.txid

    async def require_registered(self) -> None:
        """Raise NOT_REGISTERED unless registered locally or on chain; WORDS_SWAPPED if a supposedly former mnemonic is
        the member's.
        """
        if self.store.content.handle:
            return
        member = await self.find_registration(self.keys)
        if member is None:
            for keys in self.eras[:-1]:
                if await self.find_registration(keys) is not None:
                    raise BlockRobotError("WORDS_SWAPPED")
            raise BlockRobotError("NOT_REGISTERED")
        self._remember_registration(member)

    async def scan(self) -> list[KnownVisit]:
        """Read new announcements; return own, untaken visits. Leavers get known ones; with membership lost, those still
        controlled. Raises MEMBERSHIP_ENDED if none.
        """
        await self.require_registered()
        content, saved_count = self.store.content, self.store.content.scanned_count
        while True:
            try:
                page = await self._read_announcements(content.scanned_count)
            except BlockRobotError as error:
                if error.code != "MEMBERSHIP_ENDED":
                    raise
                if await self.has_left():
                    break
                return await self._scan_without_membership()
            follow_announcements(content.visits, page.items, self.eras, self.genesis.chain_id)
            content.scanned_count = page.next_number
            if page.next_number >= page.count:
                break
            saved_count = self.save_scanned(page.next_number, page.count, saved_count)
        if content.scanned_count != saved_count:
            self.store.save()
        return [visit for visit in content.visits if not visit.taken]

    def save_scanned(self, done: int, of: int, saved_count: int) -> int:
        """Save what a scan found, if enough was read since `saved_count`; return what is saved now."""
        if done - saved_count < SCAN_SAVED_EVERY_COUNT:
            return saved_count
        self.store.save()
        self.tell_scanned(done, of)
        return done

    async def _scan_without_membership(self) -> list[KnownVisit]:
        self.member_gone = True
        reached: list[KnownVisit] = []
        lost: list[KnownVisit] = []
        for visit in self.store.content.visits:
            if not visit.taken:
                (reached if await self._is_obeyed(visit) else lost).append(visit)
        self.out_of_reach = tuple(lost)
        if not reached:
            raise BlockRobotError("MEMBERSHIP_ENDED")
        return reached

    async def _is_obeyed(self, visit: KnownVisit) -> bool:
        key = self.owner_key(visit)
        try:
            current = await proved_row(self.reading(key), CURRENT, visit.owner)
        except BlockRobotError as error:
            if error.code != "SESSION_REFUSED":
                raise
            return False
        return deciding_key(visit.owner, current) == key.public_key

    async def has_left(self) -> bool:
        """By a proven receipt, without session."""
        content = self.store.content
        for txid in () if content.left else tuple(content.leaving):
            try:
                receipt = await self.network.wait_final(txid, _LOOK_UP_MS, lane=self.keys.identity.public_key)
            except BlockRobotError:
                continue
            if receipt.ok:
                content.left, content.leaving = True, []
                self.store.save()
        return content.left

    async def _read_announcements(self, first: int) -> AnnouncementPage:
        try:
            return await self.network.announcements(first, self.keys.identity)
        except BlockRobotError as error:
            if error.code == "SESSION_REFUSED":
                raise BlockRobotError("MEMBERSHIP_ENDED") from None
            raise

    async def visit_mark(self, visit: KnownVisit) -> tuple[Any, ...]:
        """Changes with the visit; one request."""
        keys = _keys_of(visit)
        found = await self.values(keys, self.owner_key(visit))
        return tuple(found[key] for key in keys)

    def trail_count_of(self, mark: tuple[Any, ...]) -> int:
        return mark[1] or 0

    async def visit_report(self, visit: KnownVisit, before: VisitReport | None = None) -> VisitReport:
        """List proven, opened, hash-chained records and count missing ones, reusing unchanged ones of `before`.

        The proven trail makes the list complete; frames withheld by the robot show as chain gaps or a missing tail at
        closing.
        """
        key = self.owner_key(visit)
        found = await self.values(_keys_of(visit), key)
        visit_state = VISIT.among(found, visit.owner)
        if visit_state is None:
            raise BlockRobotError("PROOF_INVALID", "The visit is proven not to be on the chain.")
        audit = await audit_visit(self, visit, COUNT.among(found, visit.owner) or 0)
        known = _still_true(before, visit, audit)
        entries = [] if known is None else list(known.records)
        erased = [] if known is None else list(known.erased_ids)
        unreadable = [] if known is None else list(known.unreadable_ids)
        have = {*(entry.record_id for entry in entries), *erased, *unreadable}
        ids = [entry.record_id for entry in audit if entry.kind == RECORDED_KIND and entry.record_id not in have]
        values = await self.values([RECORD.key(record_id) for record_id in ids], key)
        for record_id in ids:
            state = RECORD.among(values, record_id)
            if state is None or state.owner != visit.owner:
                continue
            if not state.sealed_metadata:
                erased.append(record_id)
                continue
            try:
                metadata = decode(self.open_metadata(state.sealed_metadata)[0], RecordMetadata)
                check_metadata(metadata)
            except BlockRobotError:
                unreadable.append(record_id)
                continue
            entries.append(RecordEntry(record_id=record_id, visit=visit, state=state, metadata=metadata))
        entries.sort(key=lambda entry: entry.metadata.index_in_visit)
        closed = visit_state.status == "closed"
        expected = (
            visit_state.record_count if closed else max((e.metadata.index_in_visit + 1 for e in entries), default=0)
        )
        gaps = find_chain_gaps([entry.metadata for entry in entries])
        return VisitReport(
            visit=visit,
            records=tuple(entries),
            erased_ids=tuple(erased),
            closed=closed,
            missing_count=max(0, max(expected - len(entries), len(gaps)) - len(erased) - len(unreadable)),
            unreadable_ids=tuple(unreadable),
            rights=read_rights(found, visit.owner, audit),
            trail_count=len(audit),
        )

    async def records(self) -> list[VisitReport]:
        """Oldest first."""
        return [await self.visit_report(visit) for visit in await self.scan()]
