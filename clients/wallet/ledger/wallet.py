"""A person's wallet: register, find, list.

Two kinds of session are kept apart. In the member's session the wallet does what everyone does (read all announcements);
whatever concerns one visit is asked in the session of that visit's owner key, on a connection of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from clients.sdk.chain.announcements import AnnouncementPage
from clients.sdk.chain.enrolment import NewMember, Registration, find_registration, register_member
from clients.sdk.chain.proved_rows import Read, in_session, proved_row
from clients.sdk.network_client import NetworkClient
from clients.wallet.ledger.visit_audit import RECORDED_KIND, AuditEntry, audit_visit
from clients.wallet.ledger.visit_scan import follow_announcements, owner_key
from clients.wallet.ledger.visit_status import VisitRights, read_standing
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
    """One record of the wallet's owner, proven and opened. Times are the robot's wall clock, in milliseconds."""

    record_id: bytes
    visit: KnownVisit
    state: RecordRow
    metadata: RecordMetadata

    @property
    def erased(self) -> bool:
        """Whether the whole record is erased."""
        return self.state.status == "erased"

    @property
    def pictures_count(self) -> int:
        """How many pictures the record had when it was made: a notice of withheld frames alone has none."""
        return 0 if self.metadata.sensor == NOTICE_SENSOR else self.metadata.frame_count

    @property
    def pictures_left_count(self) -> int:
        """How many of them are not erased."""
        return max(0, self.pictures_count - len(self.state.erased_frames))


@dataclass(frozen=True, slots=True)
class VisitReport:
    """A visit as the wallet knows it: its records in order, and whether any is missing.

    `unreadable_ids` are records whose metadata a robot sealed wrongly: they cannot be opened, and do not hide the others.
    `trail_count` is how many entries its audit trail had.
    """

    visit: KnownVisit
    records: tuple[RecordEntry, ...]
    erased_ids: tuple[bytes, ...]
    closed: bool
    missing_count: int
    unreadable_ids: tuple[bytes, ...] = ()
    standing: VisitRights = field(default_factory=VisitRights)
    trail_count: int = 0

    @property
    def needs_former_words(self) -> bool:
        """Whether records do not open since they are sealed to words of before: this visit's key was replaced."""
        return bool(self.unreadable_ids and self.visit.current)


_LOOK_UP_MS = 2_000
_CHANGES_NO_RECORD = frozenset(
    {RECORDED_KIND, "visit_closed", "access_requested", "access_released", "access_refused", "verdict", "granted"}
)
"""Kinds of events after which all records that were there before are as they were."""


def _keys_of(visit: KnownVisit) -> list[bytes]:
    """Return the keys of a visit's state, its trail's length, and the words about it."""
    kinds: tuple[Prefix[Any], ...] = (VISIT, COUNT, RESTRICTION, OBJECTION, CORRECTION_COUNT, QUARANTINE)
    return [kind.key(visit.owner) for kind in kinds]


def _still_true(before: VisitReport | None, visit: KnownVisit, trail: Sequence[AuditEntry]) -> VisitReport | None:
    """Return an earlier report if no record in it has changed since, by what stands in the trail; else None."""
    if before is None or before.visit != visit or before.trail_count > len(trail):
        return None
    return before if all(entry.kind in _CHANGES_NO_RECORD for entry in trail[before.trail_count :]) else None


class Wallet:
    """An open wallet on a network. Use as `async with`.

    `member_gone` says, after a scan, that its words make nobody a member any more, though she did not leave: what is shown
    is what the wallet knew before, and without the visits that are `out_of_reach`, whose key was replaced. Who keeps it
    open for long makes `trails` a dict, so that an entry of an audit is read once.
    """

    def __init__(self, store: Keystore, genesis: Genesis) -> None:
        self.store = store
        self.genesis = genesis
        self.load_keys()
        self.network = NetworkClient(genesis, pinned=store.content.pin or None)
        self.member_gone = False
        self.out_of_reach: tuple[KnownVisit, ...] = ()
        self.trails: dict[bytes, list[AuditEntry]] | None = None

    async def __aenter__(self) -> Wallet:
        return self

    async def __aexit__(self, *exception: object) -> None:
        self.store.content.pin = self.network.pinned or b""
        self.store.save()
        await self.network.close()

    def load_keys(self) -> None:
        """Derive the keys from the words that the wallet has, and had: `eras`, oldest first, the last being in force."""
        content = self.store.content
        self.eras: list[WalletKeys] = [derive_keys(words) for words in [*content.former, content.words]]
        self.keys: WalletKeys = self.eras[-1]

    def owner_key(self, visit: KnownVisit) -> PrivateKey:
        """Derive the private key that decides of one visit, as far as this wallet knows."""
        return owner_key(visit, self.eras[visit.era], self.genesis.chain_id)

    def open_metadata(self, sealed: bytes) -> tuple[bytes, WalletKeys]:
        """Open sealed metadata; return it and the keys that it was sealed to. Raises ENVELOPE_INVALID."""
        return self._with_any(lambda keys: (open_metadata(keys.sealing, sealed), keys))

    def open_data_key(self, sealed: bytes) -> bytes:
        """Open the key of a frame. Raises ENVELOPE_INVALID."""
        return self._with_any(lambda keys: open_data_key(keys.sealing, sealed))

    def _with_any(self, work: Callable[[WalletKeys], T]) -> T:
        """Do it with the newest keys for which it succeeds: what was sealed to former ones stays so."""
        for keys in reversed(self.eras[1:]):
            try:
                return work(keys)
            except BlockRobotError:
                continue
        return work(self.eras[0])

    async def register(self, code: str, purposes: list[str]) -> Registration:
        """Register with the code on the card, consenting to the purposes. Doing it again with the same code is harmless.

        Raises VOUCHER_INVALID for a damaged code, PURPOSE_UNKNOWN for what the network does not publish, NOT_PERMITTED
        with the contract's code if the chain refuses.
        """
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
        """Return what the chain holds of a member key of this person, proven, or None if it is no active member."""
        return await find_registration(self.network, keys.identity)

    def _remember_registration(self, member: MemberRow | Card) -> None:
        content = self.store.content
        content.handle, content.role = member.handle, member.role
        content.left, content.leaving = False, []
        self.store.save()

    async def values(self, keys: Sequence[bytes], session: PrivateKey) -> dict[bytes, Any]:
        """Return proved values of any number of flat keys, in the session of one key; None for what is absent."""
        return await in_session(self.network, session)(keys)

    def reading(self, session: PrivateKey) -> Read:
        """Return what reads rows and answers queries in the session of one key."""
        return lambda keys: self.values(keys, session)

    async def sign_and_wait(self, visit: KnownVisit, contract: str, entry: str, arguments: list[Any]) -> bytes:
        """Sign a call with the visit's owner key and wait until it is final. Returns the txid.

        Of an erasure the proof is kept. Raises CALL_REFUSED with the contract's code if the chain refuses.
        """
        receipt = await self.network.call(self.owner_key(visit), contract, entry, arguments)
        if contract == "erasure":
            keep_receipt(self.store.content, receipt)
        return receipt.txid

    async def require_registered(self) -> None:
        """Raise NOT_REGISTERED unless this wallet is registered: by its own memory, or (restored) by the chain's.

        Raises WORDS_SWAPPED if it is words that it takes for former ones that are a member's.
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
        """Read the announcements that are new since last time and return all visits that are this person's.

        Without those that somebody else has taken. Who has left reads no more announcements, and has what she knew. So
        has she whose membership ended otherwise (see `member_gone`), but for visits that obey her no more. Raises
        MEMBER_NO_MORE if she has none left.
        """
        await self.require_registered()
        content, known_count = self.store.content, self.store.content.scanned_count
        while True:
            try:
                page = await self._read_announcements(content.scanned_count)
            except BlockRobotError as error:
                if error.code != "MEMBER_NO_MORE":
                    raise
                if await self.has_left():
                    break
                return await self._scan_without_membership()
            follow_announcements(content.visits, page.items, self.eras, self.genesis.chain_id)
            content.scanned_count = page.next_number
            if page.next_number >= page.count:
                break
        if content.scanned_count != known_count:
            self.store.save()
        return [visit for visit in content.visits if not visit.taken]

    async def _scan_without_membership(self) -> list[KnownVisit]:
        """Return the visits known before that a key of this wallet still decides of, each asked in its own session."""
        self.member_gone = True
        reached: list[KnownVisit] = []
        lost: list[KnownVisit] = []
        for visit in self.store.content.visits:
            if not visit.taken:
                (reached if await self._is_obeyed(visit) else lost).append(visit)
        self.out_of_reach = tuple(lost)
        if not reached:
            raise BlockRobotError("MEMBER_NO_MORE")
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
        """Tell whether she left by this wallet: by a proven receipt, which anybody may ask for, without a session."""
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
                raise BlockRobotError("MEMBER_NO_MORE") from None
            raise

    async def visit_mark(self, visit: KnownVisit) -> tuple[Any, ...]:
        """Return what changes whenever anything changes of a visit, by one question: its state, its words, its trail."""
        keys = _keys_of(visit)
        found = await self.values(keys, self.owner_key(visit))
        return tuple(found[key] for key in keys)

    def trail_count_of(self, mark: tuple[Any, ...]) -> int:
        """Return how long the trail was of a visit that had this mark."""
        return mark[1] or 0

    async def visit_report(self, visit: KnownVisit, before: VisitReport | None = None) -> VisitReport:
        """List a visit's records, each proven, opened and chained; say how many are missing.

        From `before`, a report of the same visit, it takes over the records of which nothing that changes one stands in the
        trail since: a visit that goes on is not read all over again for each record that comes in.

        The list comes from the audit trail, whose every entry and whose length are proven, so a node can leave none out,
        not even the last ones of an open visit. What the robot itself held back shows as a gap in its chain of hashes, or
        as a missing tail by the visit's closing.
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
            standing=read_standing(found, visit.owner, audit),
            trail_count=len(audit),
        )

    async def records(self) -> list[VisitReport]:
        """Return every visit of this person with its records, oldest first."""
        return [await self.visit_report(visit) for visit in await self.scan()]
