"""Privacy notices: read, remembered, compared with earlier versions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clients.sdk.chain.notices import organisation_of_card, public_values
from clients.sdk.chain.proved_rows import proved_row
from clients.sdk.proof_checks import ProvedState
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.members.vouchers import decode_card_code
from consensus.rights.notices import (
    NoticeVersion,
    PublishedNotice,
    askable_pairs,
    change_lines,
    read_published,
    read_row,
    require_consent_asked,
)
from consensus.rights.sensors import SENSORS
from consensus.state.consent import NOTICE, NOTICE_TEXT
from consensus.state.identity import MEMBER


@dataclass(frozen=True, slots=True)
class NoticeView:
    """The current notice (`published` None: none). `before` is the differing version consented to, `changes` the
    differences, `height` proves that none is newer.
    """

    organisation: str
    published: PublishedNotice | None
    height: int
    before: NoticeVersion | None = None
    changes: tuple[str, ...] = ()

    @property
    def version(self) -> int:
        """The version, 0 if none is published."""
        return 0 if self.published is None else self.published.row.version

    def askable(self, purposes: Sequence[str]) -> dict[str, list[str]]:
        if self.published is None:
            return {code: sorted(SENSORS) for code in purposes}
        named = askable_pairs(self.published.notice)
        return {code: named[code] for code in purposes if code in named}

    def other_grounds(self) -> dict[str, str]:
        """Purposes not based on consent, with their Art. 6 ground."""
        named = [] if self.published is None else self.published.notice.purposes
        return {purpose.code: purpose.lawful_basis for purpose in named if not purpose.rests_on_consent}

    def require_named(self, purposes: Sequence[str], sensors: Sequence[str]) -> None:
        """Does the notice ask consent for these? Passes without a notice. Raises as `require_consent_asked`."""
        if self.published is not None:
            require_consent_asked(self.published, purposes, sensors)


class Notices:
    """Notices of the owner's organisations."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet

    async def for_card(self, code: str) -> NoticeView:
        """The issuer's, before registration. Raises VOUCHER_INVALID, NOTICE_INVALID, PROOF_*."""
        organisation = await organisation_of_card(self._wallet.network, decode_card_code(code))
        return await self._read(organisation, registered=False)

    async def current(self) -> NoticeView:
        """The own organisation's, and changes since consent. Raises NOT_REGISTERED, NOTICE_INVALID, PROOF_*."""
        organisation = await self._organisation()
        notice_view = await self._read(organisation, registered=True)
        consented = self._wallet.store.content.notice_consented_version
        if not 0 < consented < notice_view.version or notice_view.published is None:
            return notice_view
        before = await self._version(organisation, consented, registered=True)
        changes = change_lines(before.notice, notice_view.published.notice)
        return NoticeView(organisation, notice_view.published, notice_view.height, before.row, tuple(changes))

    async def of_organisation(self, organisation: str) -> NoticeView:
        """In force. Raises NOTICE_INVALID, PROOF_*."""
        return await self._read(organisation, registered=True)

    async def changed_since_consent(self) -> NoticeVersion | None:
        """In force, if newer than the consented one."""
        consented = self._wallet.store.content.notice_consented_version
        if not consented:
            return None
        row, _ = await self._newest(await self._organisation(), registered=True)
        return row if row is not None and row.version > consented else None

    async def due(self) -> NoticeView | None:
        """Never shown by this wallet."""
        notice_view = await self.current()
        return notice_view if self.is_new(notice_view) else None

    def is_new(self, notice_view: NoticeView) -> bool:
        return notice_view.version > self._wallet.store.content.notice_shown_version

    def note_shown(self, notice_view: NoticeView) -> None:
        content = self._wallet.store.content
        content.notice_shown_version = max(content.notice_shown_version, notice_view.version)
        self._wallet.store.save()

    def note_consented(self, notice_view: NoticeView) -> None:
        """Note that this version was shown, and consented to."""
        content = self._wallet.store.content
        content.notice_consented_version = max(content.notice_consented_version, notice_view.version)
        self.note_shown(notice_view)

    async def _organisation(self) -> str:
        await self._wallet.require_registered()
        member = self._wallet.keys.identity
        row = await proved_row(self._wallet.reading(member), MEMBER, member.public_key)
        if row is None:
            raise BlockRobotError("NOT_REGISTERED")
        return row.org

    async def _read(self, organisation: str, *, registered: bool) -> NoticeView:
        row, height = await self._newest(organisation, registered=registered)
        if row is None:
            return NoticeView(organisation, None, height)
        return NoticeView(organisation, await self._version(organisation, row.version, registered=registered), height)

    async def _newest(self, organisation: str, *, registered: bool) -> tuple[NoticeVersion | None, int]:
        """The newest version, and the height of its proof."""
        key = NOTICE.key(organisation)
        state = await self._values([key], registered=registered)
        return read_row(organisation, state.values[key]), state.height

    async def _version(self, organisation: str, version: int, *, registered: bool) -> PublishedNotice:
        key = NOTICE_TEXT.key(version, organisation)
        found = read_published(organisation, (await self._values([key], registered=registered)).values[key])
        if found is None:
            raise refusal("NOTICE_NOT_FOUND", "notice_version", organisation=organisation, version=version)
        return found

    async def _values(self, keys: Sequence[bytes], *, registered: bool) -> ProvedState:
        """In the member's session if registered, else in none."""
        network = self._wallet.network
        if registered:
            return await network.state_values(keys, self._wallet.keys.identity)
        return await public_values(network, keys)
