"""Plays robots' days with production visits, sealing, spool and delivery on a virtual clock.

No identities leak into the attackers' input.
"""

from __future__ import annotations

import asyncio
import os
import random
from contextlib import suppress
from typing import Any

from clients.robot.consent.consent_view import compute_person_tag
from clients.robot.delivery.delivery import Delivery, Whose
from clients.robot.pairing.rosters import RosterBook
from clients.robot.recording.event_log import AliasBook
from clients.robot.recording.sealing import ClipContent, seal_clip
from clients.robot.recording.spool import Delivered, Spool, SpooledClip
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.recording.visit_keyring import VisitKeyring
from clients.robot.run.pipeline import CLOSE_EVERY_S
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.members.roster import RosterRow
from consensus.primitives.encoding import decode_value
from consensus.records.clips import ClipUpload
from consensus.records.renditions import ENCODING_PNG16, RENDITION_VERSION, Rendition
from consensus.state.consent import CHOICES, effective_consent, read_choices
from consensus.state.records import RECORD, VISIT, RecordRow, VisitRow
from network.lab.privacy.hospital.attacked_chain import Chain, Final
from network.lab.privacy.hospital.household import PURPOSE, Unit
from network.lab.privacy.hospital.population import Stay

SENSOR = "depth"
WIDTH, HEIGHT = 640, 480
_TO_NODE_MS, _TO_CUSTODIAN_MS = (1.0, 6.0), (5.0, 20.0)
_BACKGROUND = bytes(32)


class RobotLink:
    """A robot's connection (`clients.robot.delivery.delivery.DeliveryNetwork`) to chain and custodian."""

    def __init__(self, chain: Chain, unit: Unit, uploads: dict[bytes, ClipUpload], dice: random.Random) -> None:
        self._chain, self._unit, self._uploads, self._dice = chain, unit, uploads, dice
        self.is_cut = False

    def sign(self, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        return self._chain.sign(self._unit.identity.identity, contract, entry, arguments)

    async def submit_and_wait(self, transaction: Transaction) -> Final:
        await self._travel(_TO_NODE_MS)
        return await self._chain.submit(transaction)

    async def robot_of_visit(self, owner: bytes) -> Whose:
        return self._whose(VISIT.at(self._chain.state, owner))

    async def robot_of_record(self, record_id: bytes) -> Whose:
        return self._whose(RECORD.at(self._chain.state, record_id))

    def _whose(self, row: VisitRow | RecordRow | None) -> Whose:
        if row is None:
            return "none"
        return "this" if row.robot == self._unit.identity.identity.public_key else "another"

    async def upload(self, upload: ClipUpload) -> None:
        await self._travel(_TO_CUSTODIAN_MS)
        self._uploads[upload.record_id] = upload

    async def _travel(self, between_ms: tuple[float, float]) -> None:
        await asyncio.sleep(self._dice.uniform(*between_ms) / 1000)
        if self.is_cut:
            raise BlockRobotError("NODE_UNREACHABLE")

    def now_ms(self) -> int:
        return self._chain.now_ms()


class RobotDay:
    """One robot's run of a day; visits close as in the pipeline."""

    def __init__(self, chain: Chain, unit: Unit, roster: RosterBook, link: RobotLink, *, at_once: bool = False) -> None:
        self.chain, self.unit, self.link = chain, unit, link
        self.roster = roster
        key = unit.identity.spool
        self.spool = Spool(unit.folder / "spool", key)
        self.open_visits = UnclosedVisitStore(unit.folder / "visits", key)
        self.visits = VisitKeyring(chain.chain_id, unit.member, PURPOSE)
        self.people: dict[str, RosterRow] = {}
        self.aliases = AliasBook()
        self._handles = {compute_person_tag(key, row.handle): row.handle for row in roster.rows}
        self.delivery = Delivery(
            self.spool,
            link,
            on_delivered=_heard,
            may_record_clip=self._may_record,
            on_dropped=self._dropped,
            at_once=at_once,
        )
        self._closing = asyncio.create_task(self._close_over())

    async def _close_over(self) -> None:
        while True:
            await asyncio.sleep(CLOSE_EVERY_S)
            await self.delivery.close_over(self.open_visits, lambda o: self.visits.goes_on(o, self.chain.now_ms()))

    async def _stop_closing(self) -> None:
        self._closing.cancel()
        with suppress(asyncio.CancelledError):
            await self._closing

    async def _may_record(self, clip: SpooledClip) -> bool:
        return self.consents(self._handles[clip.person])

    async def _dropped(self, clip: SpooledClip) -> None:
        self.open_visits.lower(clip.owner)
        self.open_visits.save()

    def consents(self, handle: bytes) -> bool:
        data = self.chain.state.get(CHOICES.key(handle))
        choices = {} if data is None else read_choices(decode_value(data))
        return effective_consent(choices.get((PURPOSE, SENSOR), ()), len(self.chain.blocks)) is not None

    def see(self, uid: str, sizes: tuple[int, ...], sequence: int) -> SpooledClip | None:
        """Seal a clip and start its delivery; None without consent."""
        row = self.roster.find(uid, self.chain.now_ms())
        if row is None:
            return None
        alias = self.aliases.alias(uid.encode())
        if not self.consents(row.handle):
            self.visits.forget(alias)
            return None
        self.people[alias] = row
        now_ms = self.chain.now_ms()
        chain = self.visits.chain_for(alias, row, now_ms)
        content = ClipContent(
            renditions=tuple(_rendition(size, now_ms, sequence + place) for place, size in enumerate(sizes)),
            withheld=(),
            sensor=SENSOR,
            decided_at_ms=now_ms,
            person=compute_person_tag(self.unit.identity.spool, row.handle),
        )
        clip = seal_clip(content, chain, now_ms=now_ms)
        self.open_visits.count(chain.owner, chain.record_count)
        name = self.spool.put(clip)
        self.open_visits.spooled(clip.owner, name)
        self.open_visits.save()
        self.delivery.start(name)
        return clip

    async def end(self) -> None:
        await self._stop_closing()
        await self.delivery.drain()
        await self.delivery.close_visits(self.open_visits)

    async def stop(self) -> None:
        await self._stop_closing()
        await self.delivery.stop()


def _heard(_: Delivered) -> None:
    """Nobody listens: an attacked robot writes no log."""


def _rendition(size: int, now_ms: int, sequence: int) -> Rendition:
    return Rendition(
        version=RENDITION_VERSION,
        captured_at_ms=now_ms,
        sequence=sequence,
        width=WIDTH,
        height=HEIGHT,
        x=0,
        y=0,
        box_width=WIDTH,
        box_height=HEIGHT,
        background_id=_BACKGROUND,
        encoding=ENCODING_PNG16,
        pixels=os.urandom(size),
    )


def frames_before(stay: Stay, clip: int) -> int:
    return sum(len(sizes) for sizes in stay.frame_bytes[:clip])
