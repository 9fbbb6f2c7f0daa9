"""Waits until a decided contract change is final, and reports its result."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import click

from clients.sdk.chain.governance import Decision
from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.lifecycle import MACHINE_TABLE, VERSION

WAIT_MAX_S = 90.0
WAIT_AHEAD_MAX_BLOCKS = 20
LOOK_EVERY_S = 1.0
TELL_EVERY_S = 10.0

no_wait_option = click.option(
    "--no-wait", is_flag=True, help="Do not wait until the change is final: only say with which block it comes."
)


@dataclass(frozen=True, slots=True)
class ChangeOutcome:
    """A change's result: in force, disabled, failed (see `failure`) or overtaken."""

    state: str
    version: int
    failure: str = ""


async def pause() -> None:
    await asyncio.sleep(LOOK_EVERY_S)


async def await_change(
    client: NetworkClient, key: PrivateKey, name: str, decision: Decision, on_progress: Callable[[str], None]
) -> ChangeOutcome | None:
    """Proved, once final; None if too far ahead or late."""
    height = decision.due_height
    if height is None or height > decision.height + WAIT_AHEAD_MAX_BLOCKS:
        return None
    record_key = VERSION.key(name, decision.due_version)
    ends = time.monotonic() + WAIT_MAX_S
    told_at = -TELL_EVERY_S
    while True:
        seen = "the nodes do not answer"
        try:
            await client.catch_up(key)
            found = await client.state_values([MACHINE_TABLE.flat, record_key], key)
            if found.height >= height:
                return _arrival(name, decision, found.values[MACHINE_TABLE.flat] or {}, found.values[record_key] or {})
            seen = f"the newest final block is {found.height}"
        except BlockRobotError as error:
            if not error.entry.retryable:
                raise
        now = time.monotonic()
        if now >= ends:
            on_progress(f"Block {height} is not final yet ({seen}); no longer waiting.")
            return None
        if now - told_at >= TELL_EVERY_S:
            told_at = now
            on_progress(f"Waiting for block {height} to be final; {seen}.")
        await pause()


def _arrival(name: str, decision: Decision, table: dict[str, Any], record: dict[str, Any]) -> ChangeOutcome:
    version = decision.due_version
    current, _, enabled, _ = table.get(name, [0, b"", False, 0])
    if decision.due_kind == "disable":
        return ChangeOutcome("overtaken" if enabled else "disabled", current)
    if record.get("status") == "failed" and record.get("since_height", 0) >= (decision.due_height or 0):
        return ChangeOutcome("failed", version, str(record.get("failure", "")))
    return ChangeOutcome("in force" if enabled and current == version else "overtaken", version)
