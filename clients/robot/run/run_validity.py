"""Limits a run to its roster's day and approved empty frames."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from clients.robot.backgrounds.background_banks import EmptyScene
from clients.robot.pairing.rosters import RosterBook
from consensus.errors import BlockRobotError

LOOK_EVERY_S = 2.0
"""How often the bank of empty frames is looked at while a run lasts."""


class RunValidity:
    """Validity of roster and bank; `look` returns the approved bank or raises BACKGROUND_*."""

    def __init__(
        self, roster: RosterBook, now_ms: Callable[[], int], look: Callable[[], EmptyScene] | None = None
    ) -> None:
        self._roster = roster
        self._now_ms = now_ms
        self._look = look
        self._scene = look() if look is not None else None
        self._over: BlockRobotError | None = None

    @property
    def is_over(self) -> bool:
        self._judge()
        return self._over is not None

    def check(self) -> None:
        """Raise one of `RUN_ENDS` if the run must end, then always."""
        self._judge()
        if self._over is not None:
            raise self._over

    def _judge(self) -> None:
        now_ms = self._now_ms()
        if self._over is None and now_ms >= self._roster.not_after_ms:
            self._over = BlockRobotError("ROSTER_EXPIRED", "The roster's day ended during the run.")
        if self._over is None and self._scene is not None and now_ms >= self._scene.expires_at_ms:
            detail = f"The approval of the empty frames of {self._scene.viewpoint} ended during the run."
            self._over = BlockRobotError("BACKGROUND_EXPIRED", detail)

    async def watch(self, end: Callable[[], None]) -> None:
        """Call `end` once due, also while no frame comes."""
        while self._over is None:
            await asyncio.sleep(LOOK_EVERY_S)
            try:
                await self._look_again()
                self.check()
            except BlockRobotError as error:
                self._over = error
        end()

    async def _look_again(self) -> None:
        if self._look is None or self._scene is None:
            return
        scene = await asyncio.to_thread(self._look)
        if scene.digest != self._scene.digest:
            detail = f"The empty frames of {scene.viewpoint} are no longer those with which the run began."
            raise BlockRobotError("BACKGROUND_NOT_APPROVED", detail)
        self._scene = scene
