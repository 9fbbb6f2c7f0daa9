"""Data subject rights: restrict, object, correct, deny. Visits are signed with their owner keys, one by one in random
order and timing against linking; general objections with the member key.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from clients.wallet.ledger.record_filter import find_visit
from clients.wallet.ledger.visit_scan import resolve_record
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.text_catalogue import refusal
from consensus.bounded_text import read_json_as
from consensus.errors import BlockRobotError
from consensus.rights.purposes import require_published
from consensus.rights.right_codes import (
    CORRECTION_MAX_BYTES,
    CORRECTION_SALT_BYTES,
    CORRECTIONS,
    GROUNDS,
    OWN_PURPOSES,
    Correction,
    commit_correction,
)
from consensus.state.rights import OBJECTION, QUARANTINE

SPREAD_MAX_MS = 4_000
OnProgress = Callable[[int, int], None]
Sleep = Callable[[float], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class RecordChoice:
    """Records of one visit; none: the whole visit."""

    visit: KnownVisit
    records: tuple[RecordEntry, ...] = ()

    @property
    def record_ids(self) -> list[bytes]:
        return [entry.record_id for entry in self.records]


@dataclass(frozen=True, slots=True)
class RightsStatement:
    """A final statement about one visit."""

    visit: KnownVisit
    record_ids: tuple[bytes, ...]
    txid: bytes
    height: int
    time_ms: int
    data: dict[str, Any] = field(default_factory=dict)


def choose(reports: Sequence[VisitReport], record_ids: Sequence[str], visits: Sequence[str]) -> list[RecordChoice]:
    """Resolve record ids and visit name prefixes (hex). Raises RECORD_NOT_FOUND, VISIT_NOT_FOUND, NAME_TOO_SHORT,
    NAME_AMBIGUOUS.
    """
    chosen = [RecordChoice(find_visit(reports, start).visit) for start in visits]
    entries = {entry.record_id.hex(): entry for report in reports for entry in report.records}
    by_visit: dict[bytes, list[RecordEntry]] = {}
    for record_id in dict.fromkeys(resolve_record(list(entries), start) for start in record_ids):
        by_visit.setdefault(entries[record_id].visit.owner, []).append(entries[record_id])
    whole = {one.visit.owner for one in chosen}
    chosen += [RecordChoice(part[0].visit, tuple(part)) for owner, part in by_visit.items() if owner not in whole]
    return chosen


class Rights:
    """Rights of the wallet's owner."""

    def __init__(self, wallet: Wallet, *, sleep: Sleep = asyncio.sleep) -> None:
        self._wallet = wallet
        self._sleep = sleep

    async def _say(self, chosen: RecordChoice, entry: str, arguments: list[Any], event: str) -> RightsStatement:
        key = self._wallet.owner_key(chosen.visit)
        receipt = await self._wallet.network.call(key, "rights", entry, arguments)
        (data,) = receipt.event_data("rights", event)
        named = tuple(chosen.record_ids)
        return RightsStatement(chosen.visit, named, receipt.txid, receipt.height, receipt.timestamp_ms, data)

    async def restrict(self, chosen: RecordChoice, ground: str) -> RightsStatement:
        """To the owner. Raises VALUE_INVALID, CALL_REFUSED."""
        if ground not in GROUNDS:
            raise refusal("VALUE_INVALID", "right_ground", given=ground, known=", ".join(GROUNDS))
        return await self._say(chosen, "restrict", [chosen.record_ids, ground], "restricted")

    async def lift(self, chosen: RecordChoice) -> RightsStatement:
        """Raises CALL_REFUSED."""
        return await self._say(chosen, "lift", [chosen.record_ids], "lifted")

    async def deny(self, visit: KnownVisit) -> RightsStatement:
        """Say that the visit shows another person. Raises CALL_REFUSED."""
        return await self._say(RecordChoice(visit), "wrong_person", [], "quarantined")

    async def correct(self, chosen: RecordChoice, kind: str, text: str) -> tuple[RightsStatement, Correction]:
        """Append a correction; text and salt are saved in the wallet before sending. Raises VALUE_INVALID,
        CALL_REFUSED.
        """
        if kind not in CORRECTIONS:
            raise refusal("VALUE_INVALID", "right_correction", given=kind, known=", ".join(CORRECTIONS))
        if not 0 < len(text.encode()) <= CORRECTION_MAX_BYTES:
            raise refusal("VALUE_INVALID", "right_bytes", most=CORRECTION_MAX_BYTES)
        correction = Correction(
            kind=kind,
            text=text,
            salt=secrets.token_bytes(CORRECTION_SALT_BYTES).hex(),
            visit=chosen.visit.owner.hex(),
            record_ids=[record_id.hex() for record_id in chosen.record_ids],
        )
        store = self._wallet.store
        store.content.corrections.append(correction)
        store.save()
        arguments = [chosen.record_ids, kind, commit_correction(correction)]
        try:
            return await self._say(chosen, "rectify", arguments, "corrected"), correction
        except BlockRobotError as error:
            if error.code == "CALL_REFUSED":
                store.content.corrections.remove(correction)
                store.save()
            raise

    async def object_to_recording(self, purposes: list[str], represented: bytes | None = None) -> int:
        """Return the effective height. `represented`: a person's handle. Raises VALUE_INVALID."""
        self._check(purposes)
        await self._wallet.require_registered()
        arguments = [represented or self._wallet.store.content.handle, purposes]
        receipt = await self._wallet.network.call(self._wallet.keys.identity, "rights", "object_to", arguments)
        (data,) = receipt.event_data("consent", "objected")
        height: int = data["height"]
        return height

    async def object_to_release(
        self, purposes: list[str], *, at_once: bool, on_progress: OnProgress
    ) -> list[RightsStatement]:
        """Object to release per visit, skipping done or denied ones. Random pauses up to four seconds prevent linking,
        unless `at_once`.
        """
        self._check(purposes)
        visits = [visit for visit in await self._wallet.scan() if await self._is_to_be_told(visit, purposes)]
        secrets.SystemRandom().shuffle(visits)
        statements = []
        for number, visit in enumerate(visits):
            on_progress(number, len(visits))
            if not at_once:
                await self._sleep(secrets.randbelow(SPREAD_MAX_MS) / 1000)
            statements.append(await self._say(RecordChoice(visit), "object_to_release", [purposes], "objected"))
        return statements

    async def say_each(
        self,
        chosen: Sequence[RecordChoice],
        say: Callable[[RecordChoice], Awaitable[RightsStatement]],
        *,
        at_once: bool,
        on_progress: OnProgress,
    ) -> tuple[list[RightsStatement], BlockRobotError | None]:
        """To each visit, paced as `object_to_release`, until a refusal. Returns results and that refusal."""
        order = list(chosen)
        secrets.SystemRandom().shuffle(order)
        statements: list[RightsStatement] = []
        for number, one in enumerate(order):
            if len(order) > 1:
                on_progress(number, len(order))
                if not at_once:
                    await self._sleep(secrets.randbelow(SPREAD_MAX_MS) / 1000)
            try:
                statements.append(await say(one))
            except BlockRobotError as error:
                return statements, error
        return statements, None

    async def _is_to_be_told(self, visit: KnownVisit, purposes: list[str]) -> bool:
        keys = [OBJECTION.key(visit.owner), QUARANTINE.key(visit.owner)]
        found = await self._wallet.values(keys, self._wallet.owner_key(visit))
        known = OBJECTION.among(found, visit.owner) or {}
        return QUARANTINE.among(found, visit.owner) is None and not all(code in known for code in purposes)

    def _check(self, purposes: list[str]) -> None:
        require_published(purposes, self._wallet.genesis.purposes)
        for code in purposes:
            if code in OWN_PURPOSES:
                raise refusal("VALUE_INVALID", "right_own", given=code)


def write_correction(correction: Correction) -> bytes:
    """To verify its commitment on chain."""
    return msgspec.json.format(msgspec.json.encode(correction), indent=2) + b"\n"


def read_correction(data: bytes) -> Correction:
    """Raises FILE_UNUSABLE."""
    try:
        correction = read_json_as(data, Correction)
        commit_correction(correction)
        return correction
    except ValueError:
        raise refusal("FILE_UNUSABLE", "right_file") from None
