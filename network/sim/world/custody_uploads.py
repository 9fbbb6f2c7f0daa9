"""Upload accounting in the simulator's custody store."""

from __future__ import annotations

from typing import TYPE_CHECKING

from node.custody.stores.custody_store import ClipRow
from node.custody.uploads import USAGE_KEPT_DAYS, DayUse, Use


class MemoryUploads:
    """In-memory `UploadAccount`, part of `MemoryCustodyStore`."""

    if TYPE_CHECKING:  # the store's own
        _clips: dict[bytes, ClipRow]
        _day_uses: dict[tuple[int, bytes], int]

        def _require_open(self) -> None: ...

        async def _begin_writing(self) -> None: ...

    async def use_by_robot(self, status: str) -> dict[bytes, Use]:
        self._require_open()
        used: dict[bytes, Use] = {}
        for clip in self._clips.values():
            if clip.status == status:
                used[clip.robot] = used.get(clip.robot, Use()) + Use(1, clip.size_bytes)
        return used

    async def add_use(self, use: DayUse) -> None:
        await self._begin_writing()
        place = (use.day, use.robot)
        self._day_uses[place] = self._day_uses.get(place, 0) + use.size_bytes
        for old in [place for place in self._day_uses if place[0] < use.day - USAGE_KEPT_DAYS]:
            del self._day_uses[old]

    async def day_uses(self) -> list[DayUse]:
        self._require_open()
        return [DayUse(*place, size_bytes) for place, size_bytes in sorted(self._day_uses.items())]
