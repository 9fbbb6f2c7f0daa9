"""Injects seeded link faults into outgoing frames above TLS."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import Callable, Mapping
from random import Random

import msgspec

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import tagged_hash
from node.p2p.wire import HEADER_SIZE_BYTES, FrameKind

DELAY_MAX_MS = 60_000.0
BANDWIDTH_MAX_BYTES_PER_S = 1_000_000_000_000
QUEUE_MAX_BYTES = 32 * 1024 * 1024
_KIND_PLACE = HEADER_SIZE_BYTES - 1


class LinkFault(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Faults of one link direction; delay is `delay_ms` plus up to `jitter_ms`.

    `loss`: share of lost frames; `bandwidth_bytes_per_s`: 0 means unlimited.
    """

    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    bandwidth_bytes_per_s: int = 0
    cut: bool = False

    def check(self) -> None:
        """Raise FAULT_INVALID for values out of range."""
        times = (self.delay_ms, self.jitter_ms)
        if not all(math.isfinite(value) and 0 <= value <= DELAY_MAX_MS for value in times):
            raise BlockRobotError("FAULT_INVALID", f"A delay lies between 0 and {DELAY_MAX_MS:.0f} ms.")
        if not (math.isfinite(self.loss) and 0 <= self.loss < 1):
            raise BlockRobotError(
                "FAULT_INVALID", "The loss is a share from 0 to below 1; for all of it, cut the link."
            )
        if not 0 <= self.bandwidth_bytes_per_s <= BANDWIDTH_MAX_BYTES_PER_S:
            most = f"{BANDWIDTH_MAX_BYTES_PER_S} bytes"
            raise BlockRobotError("FAULT_INVALID", f"A bandwidth is up to {most} in a second, or 0 for no limit.")

    @property
    def is_sound(self) -> bool:
        return self == SOUND

    def describe(self) -> str:
        if self.cut:
            return "cut"
        delay = f"{self.delay_ms:g}" + (f"-{self.delay_ms + self.jitter_ms:g}" if self.jitter_ms else "")
        parts = [f"{delay} ms"] if self.delay_ms or self.jitter_ms else []
        parts += [f"{self.loss:.1%} lost"] if self.loss else []
        parts += [f"{self.bandwidth_bytes_per_s / 1000:g} kB/s"] if self.bandwidth_bytes_per_s else []
        return ", ".join(parts) or "sound"


SOUND = LinkFault()


class _Link:
    def __init__(self, chance: Random) -> None:
        self.chance = chance
        self.waiting_bytes = 0
        self.busy_until_s = 0.0
        self.last_due_s = 0.0
        self.queue: deque[tuple[float, bytes, Callable[[bytes], None]]] = deque()


class LinkFaultShaper:
    """Every direction out of one node. On the event loop only."""

    def __init__(self, own_name: str, seed: int = 0) -> None:
        self._own_name = own_name
        self._seed = seed
        self._faults: dict[str, LinkFault] = {}
        self._links: dict[str, _Link] = {}
        self.lost_count = 0

    @property
    def faults(self) -> Mapping[str, LinkFault]:
        return self._faults

    @property
    def seed(self) -> int:
        return self._seed

    def reseed(self, seed: int) -> None:
        self._seed = seed
        for peer, link in self._links.items():
            link.chance = self._chance_of(peer)

    def set_link(self, peer: str, fault: LinkFault) -> None:
        """Raises FAULT_INVALID."""
        fault.check()
        if fault.is_sound:
            self._faults.pop(peer, None)
        else:
            self._faults[peer] = fault

    def clear(self) -> None:
        self._faults.clear()

    # LinkShaper

    def admits(self, peer: str) -> bool:
        return not self._faults.get(peer, SOUND).cut

    def waiting_bytes(self, peer: str) -> int:
        link = self._links.get(peer)
        return 0 if link is None else link.waiting_bytes

    def deliver(self, peer: str, frame: bytes, send: Callable[[bytes], None]) -> None:
        """Call `send` now, later or never; greetings are never lost."""
        fault = self._faults.get(peer)
        link = self._links.get(peer)
        if fault is None and (link is None or not link.waiting_bytes):
            send(frame)
            return
        if link is None:
            link = self._links[peer] = _Link(self._chance_of(peer))
        if self._is_lost(fault or SOUND, link, frame):
            self.lost_count += 1
            return
        loop = asyncio.get_running_loop()
        due_s = self._due(fault or SOUND, link, len(frame), loop.time())
        link.waiting_bytes += len(frame)
        link.queue.append((due_s, frame, send))
        if len(link.queue) == 1:
            loop.call_at(due_s, self._arrive, peer, link)

    def _is_lost(self, fault: LinkFault, link: _Link, frame: bytes) -> bool:
        if fault.cut or link.waiting_bytes + len(frame) > QUEUE_MAX_BYTES:
            return True
        return frame[_KIND_PLACE] != FrameKind.HELLO and fault.loss > 0 and link.chance.random() < fault.loss

    def _due(self, fault: LinkFault, link: _Link, size_bytes: int, now_s: float) -> float:
        start_s = max(now_s, link.busy_until_s)
        rate = fault.bandwidth_bytes_per_s
        link.busy_until_s = start_s + size_bytes / rate if rate else now_s
        wait_ms = fault.delay_ms + (link.chance.uniform(0, fault.jitter_ms) if fault.jitter_ms else 0.0)
        link.last_due_s = max(link.last_due_s, link.busy_until_s + wait_ms / 1000)
        return link.last_due_s

    def _arrive(self, peer: str, link: _Link) -> None:
        """Send due frames in order: one timer per link, since equal timers fire unordered."""
        loop = asyncio.get_running_loop()
        while link.queue:
            due_s, frame, send = link.queue[0]
            if due_s > loop.time():
                loop.call_at(due_s, self._arrive, peer, link)
                return
            if self._faults.get(peer, SOUND).cut:
                self.lost_count += 1
            else:
                send(frame)
            link.waiting_bytes -= len(frame)
            link.queue.popleft()

    def _chance_of(self, peer: str) -> Random:
        text = f"{self._seed} {self._own_name} {peer}"
        return Random(int.from_bytes(tagged_hash("blockrobot/link-chance", text.encode()), "big"))  # noqa: S311
