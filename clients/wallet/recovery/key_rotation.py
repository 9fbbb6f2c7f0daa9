"""Replaces a stolen mnemonic: member key, then visit keys; every step is repeatable."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from clients.wallet.ledger.wallet import Wallet
from clients.wallet.sharing.outgoing_shares import SharingClient
from clients.wallet.store.kept_proofs import keep_receipt
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.store.member_keys import WalletKeys, derive_keys, draw_words
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.members.vouchers import sign_rotation
from consensus.records.owner_keys import VisitKeys, derive_owner_key, open_visit_keys, sign_transfer

OnProgress = Callable[[int, int, float], None]
Sleep = Callable[[float], Awaitable[None]]
_EPHEMERAL_BYTES = 32
_MOVED_TOO_OFTEN = "TRANSFERS_TOO_MANY"
_KEY_REPLACED = frozenset({"CALL_REFUSED", "SENDER_NOT_ADMITTED"})


@dataclass(frozen=True, slots=True)
class Transferred:
    """Result of transferring visits; `stuck` ones are not transferable, `ended` are revoked unknown grant ids."""

    done: tuple[KnownVisit, ...]
    taken: tuple[KnownVisit, ...]
    stuck: tuple[KnownVisit, ...]
    refusal: BlockRobotError | None = None
    ended: tuple[bytes, ...] = ()


class KeyRotation:
    """Replacement of one wallet's mnemonic."""

    def __init__(self, wallet: Wallet, *, sleep: Sleep = asyncio.sleep) -> None:
        self._wallet = wallet
        self._sleep = sleep

    def prepare(self) -> str:
        """Return the next mnemonic, saved before it is shown; always the same."""
        store = self._wallet.store
        if not store.content.next_words:
            store.content.next_words, store.content.next_words_shown = draw_words(), False
            store.save()
        return store.content.next_words

    @property
    def must_show(self) -> bool:
        content = self._wallet.store.content
        return bool(content.next_words) and not content.next_words_shown

    def confirm_shown(self) -> None:
        """Record that the owner has the new mnemonic; it is then used and not shown again."""
        store = self._wallet.store
        store.content.next_words_shown = True
        store.save()

    async def rotate(self) -> bool:
        """Replace the member key; return whether anything was left to do.

        Raises VALUE_INVALID before `confirm_shown`, MEMBERSHIP_ENDED if neither key is a member's, CALL_REFUSED.
        """
        wallet, content = self._wallet, self._wallet.store.content
        if not content.next_words:
            return False
        if self.must_show:
            raise refusal("VALUE_INVALID", "words_hidden")
        new = derive_keys(content.next_words)
        if await wallet.find_registration(new) is None:
            member = await wallet.find_registration(wallet.keys)
            if member is None:
                raise BlockRobotError("MEMBERSHIP_ENDED")
            try:
                await self._say_rotation(member.handle, new)
            except BlockRobotError as error:
                # What was sent before a cut may have become final in between.
                if error.code not in _KEY_REPLACED or await wallet.find_registration(new) is None:
                    raise
        content.former.append(content.words)
        content.words, content.next_words, content.next_words_shown = content.next_words, "", False
        content.transfers_due = True
        # No custodian signs a receipt for a key that was replaced: what was not fetched before never comes.
        content.receipts_due = []
        wallet.store.save()
        wallet.load_keys()
        return True

    async def _say_rotation(self, handle: bytes, new: WalletKeys) -> None:
        wallet = self._wallet
        identity = wallet.keys.identity
        keys = [new.spend.public_key, new.view.public_key, new.sealing_public]
        signature = sign_rotation(
            new.identity,
            chain_id=wallet.genesis.chain_id,
            handle=handle,
            member=identity.public_key,
            spend=keys[0],
            view=keys[1],
            sealing=keys[2],
        )
        arguments = [handle, new.identity.public_key, *keys, signature]
        keep_receipt(wallet.store.content, await wallet.network.call(identity, "identity", "rotate", arguments))

    async def exposed_visits(self) -> list[KnownVisit]:
        """Still controlled by a former mnemonic. Raises MEMBERSHIP_ENDED among others."""
        wallet = self._wallet
        newest = len(wallet.eras) - 1
        return [visit for visit in await wallet.scan() if visit.era != newest]

    async def transfer(self, visit: KnownVisit) -> None:
        """To the present mnemonic's key. Raises CALL_REFUSED."""
        keys = self._draw_keys(visit)
        wallet = self._wallet
        arguments = [keys.owner, keys.ephemeral, keys.view_tag, self._sign_transfer(visit, keys)]
        await wallet.network.call(wallet.owner_key(visit), "records", "transfer", arguments)
        for known in wallet.store.content.visits:
            if known.owner == visit.owner:
                known.current, known.ephemeral, known.era = keys.owner, keys.ephemeral, len(wallet.eras) - 1
                known.stuck = False
        wallet.store.save()

    def _draw_keys(self, visit: KnownVisit) -> VisitKeys:
        keys = self._wallet.keys
        return open_visit_keys(
            secrets.token_bytes(_EPHEMERAL_BYTES),
            keys.view.public_key,
            keys.spend.public_key,
            chain_id=self._wallet.genesis.chain_id,
            robot=visit.robot,
        )

    def _sign_transfer(self, visit: KnownVisit, new: VisitKeys) -> bytes:
        keys, chain_id = self._wallet.keys, self._wallet.genesis.chain_id
        key = derive_owner_key(keys.spend, keys.view, new.ephemeral, chain_id=chain_id, robot=visit.robot)
        return sign_transfer(key, chain_id=chain_id, root=visit.owner)

    async def transfer_all(self, over_s: float, on_progress: OnProgress, *, keep_shares: bool = False) -> Transferred:
        """Transfer all visits of former mnemonics, in random order over `over_s` seconds (unlinkability).

        Then end unknown grants unless `keep_shares`. Contract refusals are reported last; other errors abort.
        """
        order = await self._due_visits()
        ended: list[bytes] = []
        chance = secrets.SystemRandom()
        chance.shuffle(order)
        moments = sorted(chance.random() * over_s for _ in order)
        refusal: BlockRobotError | None = None
        for number, visit in enumerate(order):
            pause_s = moments[number] - (moments[number - 1] if number else 0.0)
            on_progress(number, len(order), pause_s)
            if over_s:
                await self._sleep(pause_s)
            try:
                ended += await self._renew(visit, keep_shares=keep_shares)
            except BlockRobotError as error:
                refusal = refusal or error
                if error.code != "CALL_REFUSED":
                    break
        if refusal is None:
            self._wallet.store.content.transfers_due = False
            self._wallet.store.save()
        known, newest = self._wallet.store.content.visits, len(self._wallet.eras) - 1
        tried = {visit.owner for visit in order}
        return Transferred(
            done=tuple(visit for visit in known if visit.owner in tried and visit.era == newest and not visit.taken),
            taken=tuple(visit for visit in known if visit.taken),
            stuck=tuple(visit for visit in known if visit.stuck and not visit.taken),
            refusal=refusal,
            ended=tuple(ended),
        )

    async def _due_visits(self) -> list[KnownVisit]:
        exposed = await self.exposed_visits()
        return exposed + [visit for visit in self._moved if visit.shares_due]

    @property
    def _moved(self) -> list[KnownVisit]:
        newest = len(self._wallet.eras) - 1
        return [visit for visit in self._wallet.store.content.visits if visit.era == newest and not visit.taken]

    async def _renew(self, visit: KnownVisit, *, keep_shares: bool) -> list[bytes]:
        store = self._wallet.store
        if visit not in self._moved:
            visit.shares_due = True
            store.save()
            await self._move(visit)
        ended: list[bytes] = []
        for moved in self._moved:
            if moved.owner == visit.owner:
                ended += [] if keep_shares else await SharingClient(self._wallet).end_unknown(moved)
                moved.shares_due = False
                store.save()
        return ended

    async def _move(self, visit: KnownVisit) -> None:
        while True:
            try:
                await self.transfer(visit)
            except BlockRobotError as error:
                if error.code not in _KEY_REPLACED:
                    raise
                again = next((each for each in await self.exposed_visits() if each.owner == visit.owner), None)
                if again is None:
                    return
                if again.current == visit.current:
                    if error.context.get("contract_code") != _MOVED_TOO_OFTEN:
                        raise
                    again.stuck = True
                    self._wallet.store.save()
                    return
                # It was moved under former words. That ends: the contract counts how often.
                visit = again
            else:
                return

    async def leave(self) -> int:
        """End the membership; return the height from which it counts, 0 if it had ended already.

        The transaction is saved before sending. Raises WALLET_ROTATION_OPEN, MEMBERSHIP_ENDED, CALL_REFUSED.
        """
        wallet, content = self._wallet, self._wallet.store.content
        if content.next_words:
            raise BlockRobotError("WALLET_ROTATION_OPEN")
        await wallet.scan()
        if await wallet.find_registration(wallet.keys) is None:
            if not await wallet.has_left():
                raise BlockRobotError("MEMBERSHIP_ENDED")
            return 0
        transaction = wallet.network.transactions.build(wallet.keys.identity, "identity", "leave", [content.handle])
        content.leaving.append(transaction.txid)
        wallet.store.save()
        receipt = (await wallet.network.submit_and_wait(transaction)).require_ok()
        content.left, content.leaving = True, []
        wallet.store.save()
        return receipt.height
