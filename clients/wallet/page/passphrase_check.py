"""Repeated passphrase check before irreversible actions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from clients.wallet.store.keystore import Keystore
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError

FREE_ATTEMPTS_COUNT = 5
ATTEMPTS_MAX_COUNT = 10
LOCK_FIRST_MS = 60_000
SETTLE_MAX_S = 20.0


class PassphraseGate:
    """Checks the passphrase; `give_up` runs after too many failures."""

    def __init__(self, store: Keystore, now_ms: Callable[[], int], give_up: Callable[[], None]) -> None:
        self._store = store
        self._now_ms = now_ms
        self._give_up = give_up
        self._wrong_count = 0
        self._locked_until_ms = 0
        self._lock = asyncio.Lock()
        self._open_count = 0
        self._refused_count = 0
        self._none_open = asyncio.Event()
        self._is_over = False

    @property
    def is_asked(self) -> bool:
        return self._open_count > 0

    async def require(self, passphrase: str) -> None:
        """One check at a time. Raises WALLET_PASSPHRASE_WRONG, PASSPHRASE_LOCKED, PAGE_SESSION_REQUIRED. Callers act at
        once, before any other await.
        """
        self._open_count += 1
        try:
            await self._check(passphrase)
            if self._is_over:
                raise BlockRobotError("PAGE_SESSION_REQUIRED")
        except BaseException:  # whatever it is, nothing begins
            self._refused_count += 1
            raise
        finally:
            self._open_count -= 1
            if not self._open_count:
                self._none_open.set()

    async def finish_checks(self) -> bool:
        """Wait briefly, then reject all; return whether all passed."""
        refused_before = self._refused_count
        try:
            async with asyncio.timeout(SETTLE_MAX_S):
                while self._open_count:
                    self._none_open.clear()
                    await self._none_open.wait()
        except TimeoutError:
            return False
        finally:
            self._is_over = True
        return self._refused_count == refused_before

    async def _check(self, passphrase: str) -> None:
        async with self._lock:
            if self._wrong_count >= ATTEMPTS_MAX_COUNT:
                raise refusal("PASSPHRASE_LOCKED", "passphrase_closed")
            left_ms = self._locked_until_ms - self._now_ms()
            if left_ms > 0:
                raise refusal("PASSPHRASE_LOCKED", "passphrase_wait", count=-(-left_ms // 1000))
            if await asyncio.to_thread(self._store.opens_with, passphrase):
                self._wrong_count = 0
                return
            self._wrong_count += 1
            left = FREE_ATTEMPTS_COUNT - self._wrong_count
            if self._wrong_count >= ATTEMPTS_MAX_COUNT:
                self._give_up()
                raise refusal("PASSPHRASE_LOCKED", "passphrase_closed")
            if left > 0:
                raise refusal("WALLET_PASSPHRASE_WRONG", "passphrase_left", count=left)
            lock_ms = LOCK_FIRST_MS << -left
            self._locked_until_ms = self._now_ms() + lock_ms
            raise refusal("PASSPHRASE_LOCKED", "passphrase_wrong_wait", count=lock_ms // 1000)
