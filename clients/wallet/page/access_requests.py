"""Access requests of the page: one on chain per look, identified by the page's random text."""

from __future__ import annotations

from collections.abc import Sequence

from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.records.viewing import RecordViewer

LOOKS_MAX_COUNT = 32
LOOK_NAME_MAX_CHARS = 64


class AccessRequests:
    """Access requests by look and purpose, least recently used evicted."""

    def __init__(self) -> None:
        self._requests: dict[tuple[str, str], dict[bytes, bytes]] = {}

    async def request(
        self, viewing: RecordViewer, look: str, purpose: str, entries: Sequence[RecordEntry]
    ) -> dict[bytes, bytes]:
        """Return access ids by record, requesting missing ones on chain."""
        known = self._requests.pop((look, purpose), {})
        if look:
            self._requests[look, purpose] = known
            while len(self._requests) > LOOKS_MAX_COUNT:
                del self._requests[next(iter(self._requests))]
        missing = [entry for entry in entries if entry.record_id not in known]
        for part in await viewing.split_requests(missing):
            access_id = await viewing.request_access(part, purpose)
            known |= {entry.record_id: access_id for entry in part}
        return known

    def forget(self, look: str) -> None:
        for key in [key for key in self._requests if key[0] == look]:
            del self._requests[key]

    def forget_all(self) -> None:
        self._requests.clear()
