"""Fetches missing clips from other custodians, sparing the disk's reserve."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

import structlog

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from node.custody.stores.custody_store import CustodyStore, RecordFacts

if TYPE_CHECKING:
    from consensus.records.clips import ClipDownload

FETCH_AT_ONCE_COUNT = 32
MISSING_READ_COUNT = 10_000

log = structlog.get_logger(__name__)


class PeerCustodian(Protocol):
    """A custodian of another node, asked for clips."""

    @property
    def name(self) -> str: ...

    async def fetch(self, record_id: bytes) -> ClipDownload | None: ...


class ClipFetcher:
    """Mixin of `Custodian` that fetches missing clips."""

    if TYPE_CHECKING:  # the custodian's own
        _store: CustodyStore
        _has_room: Callable[[int], bool]
        _asked_for: set[bytes]
        _waited_s: dict[str, float]

        async def install(self, fetched: ClipDownload) -> bool: ...

    async def fetch_missing(self, peers: Sequence[PeerCustodian]) -> int:
        """Fetch up to 32 missing clips, newest first, in turns, from who answered fastest; return those installed."""
        installed = 0
        for facts in await self._choose_missing():
            if not self._has_room(CLIP_SIZE_MAX_BYTES):
                log.warning("clips_not_fetched", code="DISK_RESERVE_REACHED")
                break
            for peer in sorted(peers, key=lambda each: self._waited_s.get(each.name, 0.0)):
                try:
                    fetched = await self._fetch_timed(peer, facts.record_id)
                    found = fetched is not None and fetched.record_id == facts.record_id
                    if fetched is not None and found and await self.install(fetched):
                        installed += 1
                        self._asked_for.discard(facts.record_id)
                        break
                except BlockRobotError as error:
                    if error.code in {"STORE_UNAVAILABLE", "ERASE_KEYS_DAMAGED"}:
                        raise
                    log.info("custody_fetch_refused", peer=peer.name, code=error.code)
        return installed

    async def _fetch_timed(self, peer: PeerCustodian, record_id: bytes) -> ClipDownload | None:
        now_s = asyncio.get_running_loop().time
        begun_s = now_s()
        try:
            fetched = await peer.fetch(record_id)
        except BlockRobotError:
            self._waited_s[peer.name] = math.inf
            raise
        self._waited_s[peer.name] = now_s() - begun_s
        return fetched

    async def _choose_missing(self) -> list[RecordFacts]:
        # So many are due or asked for already: a batch costs what nobody had, not what is missing.
        missing = await self._store.missing(min(MISSING_READ_COUNT, len(self._asked_for) + FETCH_AT_ONCE_COUNT))
        due = [facts for facts in missing if facts.record_id not in self._asked_for]
        if not due:
            self._asked_for.clear()
            due = missing
        chosen = due[:FETCH_AT_ONCE_COUNT]
        self._asked_for.update(facts.record_id for facts in chosen)
        return chosen
