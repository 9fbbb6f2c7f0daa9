"""Fault actions as values, each with a description."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from consensus.errors import BlockRobotError
from network.byzantine import check_behaviour
from node.faults import CLOCK_OFFSET_MAX_MS, DISKS, SEED_MAX
from node.p2p.link_faults import BANDWIDTH_MAX_BYTES_PER_S, SOUND, LinkFault
from pages.time_format import UNITS_MS, parse_duration

_LINK = re.compile(r"\s*(\S+?)\s*(<->|->)\s*(\S+?)\s*")


@dataclass(frozen=True, slots=True)
class _OfOneNode:
    """A fault of one node."""

    node: str

    def touched(self) -> tuple[str, ...]:
        return (self.node,)

    def describe(self) -> str:
        return f"{type(self).__name__.lower()} {self.node}"


class Kill(_OfOneNode):
    """SIGKILL: nothing flushed."""


class Restart(_OfOneNode):
    """Start a node as honest, after a clean stop if running; other faults stay."""


class Pause(_OfOneNode):
    """SIGSTOP: connections stay open, nothing is sent."""


class Resume(_OfOneNode):
    """SIGCONT."""


@dataclass(frozen=True, slots=True)
class Partition:
    """Isolate groups of nodes. Replaces an earlier partition; one group joins all."""

    groups: tuple[tuple[str, ...], ...]

    def touched(self) -> tuple[str, ...]:
        return tuple(name for group in self.groups for name in group)

    def describe(self) -> str:
        if len(self.groups) == 1:
            return "join " + ", ".join(self.groups[0])
        return "partition " + " | ".join(", ".join(group) for group in self.groups)


@dataclass(frozen=True, slots=True)
class Heal:
    """End all faults of these nodes (none named: all); killed nodes stay down."""

    nodes: tuple[str, ...] = ()

    def touched(self) -> tuple[str, ...]:
        """Empty for all that accept faults."""
        return self.nodes

    def describe(self) -> str:
        return "heal " + (", ".join(self.nodes) or "everything")


@dataclass(frozen=True, slots=True)
class SetLink:
    """Set the link fault of one direction between nodes, or both."""

    source: str
    target: str
    fault: LinkFault
    is_both: bool = False

    def touched(self) -> tuple[str, ...]:
        return (self.source, self.target)

    def describe(self) -> str:
        return f"link {self.source} {'<->' if self.is_both else '->'} {self.target}: {self.fault.describe()}"


@dataclass(frozen=True, slots=True)
class Skew(_OfOneNode):
    """Set a node's clock offset; a change is a jump."""

    offset_ms: int

    def describe(self) -> str:
        return f"skew {self.node} by {format_duration(self.offset_ms)}"


@dataclass(frozen=True, slots=True)
class FillDisk(_OfOneNode):
    """Make a node's disk for this part full, or free again."""

    disk: str
    is_full: bool = True

    def describe(self) -> str:
        return f"disk of {self.node} under its {self.disk}: {'full' if self.is_full else 'free again'}"


@dataclass(frozen=True, slots=True)
class GoByzantine(_OfOneNode):
    """Restart a node with a Byzantine behaviour."""

    behaviour: str
    seed: int = 0

    def describe(self) -> str:
        return f"byzantine {self.node}: {self.behaviour} (seed {self.seed})"


Action = Kill | Restart | Pause | Resume | Partition | Heal | SetLink | Skew | FillDisk | GoByzantine


@dataclass(frozen=True, slots=True)
class ActionReader:
    """Builds actions for these nodes from text. Methods raise FAULT_UNKNOWN and FAULT_INVALID."""

    names: Sequence[str] = field(default=())

    def node(self, name: str) -> str:
        if name not in self.names:
            raise BlockRobotError("FAULT_UNKNOWN", f"There is no node {name!r}; there are {', '.join(self.names)}.")
        return name

    def partition(self, text: str) -> Partition:
        """Groups such as `a,b | c,d`; unnamed nodes form one more group."""
        groups = [tuple(self.node(name.strip()) for name in part.split(",")) for part in text.split("|")]
        named = [name for group in groups for name in group]
        if len(set(named)) != len(named):
            raise BlockRobotError("FAULT_INVALID", "A node stands in two groups.")
        rest = tuple(name for name in self.names if name not in named)
        groups += [rest] if rest else []
        if len(groups) < 2:
            raise BlockRobotError(
                "FAULT_INVALID", "A partition has two groups or more: `node-1,node-2 | node-3,node-4`."
            )
        return Partition(tuple(groups))

    def link(self, text: str, fault: LinkFault) -> SetLink:
        found = _LINK.fullmatch(text)
        if found is None:
            raise BlockRobotError("FAULT_INVALID", "A link is `A -> B` (one direction) or `A <-> B`.")
        source, target = self.node(found[1]), self.node(found[3])
        if source == target:
            raise BlockRobotError("FAULT_INVALID", "A link joins two nodes.")
        fault.check()
        return SetLink(source, target, fault, is_both=found[2] == "<->")

    def skew(self, name: str, offset: str) -> Skew:
        offset_ms = 0 if offset.strip() in {"0", "+0", "-0"} else read_duration(offset)
        if abs(offset_ms) > CLOCK_OFFSET_MAX_MS:
            raise BlockRobotError("FAULT_INVALID", "A clock is wrong by ten years at most.")
        return Skew(self.node(name), offset_ms)

    def disk(self, name: str, disk: str, *, is_full: bool) -> FillDisk:
        if disk not in DISKS:
            raise BlockRobotError("FAULT_UNKNOWN", f"There is no disk {disk!r}; there are {', '.join(DISKS)}.")
        return FillDisk(self.node(name), disk, is_full)

    def byzantine(self, name: str, behaviour: str, seed: int) -> GoByzantine:
        check_behaviour(behaviour)
        return GoByzantine(self.node(name), behaviour, check_seed(seed))


@dataclass(frozen=True, slots=True)
class LinkProfile:
    """A kind of link and its meaning; figures are per direction, so a round trip doubles the delay."""

    fault: LinkFault
    meaning: str


LINK_PROFILES: dict[str, LinkProfile] = {
    "lan": LinkProfile(
        LinkFault(delay_ms=0.2, jitter_ms=0.1, bandwidth_bytes_per_s=125_000_000),
        "one building, wired: 0.2-0.3 ms, nothing lost, 1 Gbit/s",
    ),
    "hospital-wifi": LinkProfile(
        LinkFault(delay_ms=3, jitter_ms=12, loss=0.01, bandwidth_bytes_per_s=2_500_000),
        "a busy ward's wireless: 3-15 ms, 1% lost, 20 Mbit/s",
    ),
    "wan": LinkProfile(
        LinkFault(delay_ms=40, jitter_ms=10, loss=0.001, bandwidth_bytes_per_s=6_250_000),
        "two cities: 40-50 ms, 0.1% lost, 50 Mbit/s",
    ),
    "lossy": LinkProfile(
        LinkFault(delay_ms=20, jitter_ms=60, loss=0.1, bandwidth_bytes_per_s=625_000),
        "a bad mobile link: 20-80 ms, 10% lost, 5 Mbit/s",
    ),
}


def link_profile(name: str) -> LinkFault:
    """Raises FAULT_UNKNOWN."""
    if name not in LINK_PROFILES:
        raise BlockRobotError(
            "FAULT_UNKNOWN", f"There is no link profile {name!r}; there are {', '.join(LINK_PROFILES)}."
        )
    return LINK_PROFILES[name].fault


def make_link_fault(
    *,
    profile: str | None = None,
    delay_ms: float | None = None,
    jitter_ms: float | None = None,
    loss: float | None = None,
    bandwidth_kbytes_per_s: float | None = None,
    cut: bool = False,
) -> LinkFault:
    """A profile's figures, overridden by those given. Raises FAULT_UNKNOWN, FAULT_INVALID."""
    figures = (profile, delay_ms, jitter_ms, loss, bandwidth_kbytes_per_s)
    if cut and any(figure is not None for figure in figures):
        raise BlockRobotError("FAULT_INVALID", "A link that is cut lets nothing through: no profile or figure fits it.")
    base = SOUND if profile is None else link_profile(profile)
    fault = LinkFault(
        delay_ms=base.delay_ms if delay_ms is None else delay_ms,
        jitter_ms=base.jitter_ms if jitter_ms is None else jitter_ms,
        loss=base.loss if loss is None else loss,
        bandwidth_bytes_per_s=(
            base.bandwidth_bytes_per_s if bandwidth_kbytes_per_s is None else _bytes_per_s(bandwidth_kbytes_per_s)
        ),
        cut=cut,
    )
    fault.check()
    return fault


def _bytes_per_s(kbytes_per_s: float) -> int:
    """Raises FAULT_INVALID, also if rounding gives 0 (no limit)."""
    bytes_per_s = kbytes_per_s * 1000
    if not math.isfinite(bytes_per_s) or not (bytes_per_s == 0 or 1 <= bytes_per_s <= BANDWIDTH_MAX_BYTES_PER_S):
        most = BANDWIDTH_MAX_BYTES_PER_S // 1000
        raise BlockRobotError("FAULT_INVALID", f"A bandwidth is 0.001 to {most} kB/s, or 0 for no limit.")
    return round(bytes_per_s)


def check_seed(seed: int) -> int:
    """Raises FAULT_INVALID if out of range."""
    if not 0 <= seed <= SEED_MAX:
        raise BlockRobotError("FAULT_INVALID", f"A seed is a whole number from 0 to {SEED_MAX}.")
    return seed


def read_duration(text: str) -> int:
    """`250ms`, `-90s`, `1h30m`. Raises FAULT_INVALID."""
    try:
        return parse_duration(text)
    except ValueError:
        detail = f"{text!r} is no duration; write 250ms, 2s, -90s, 5m, 1h30m or 2d."
        raise BlockRobotError("FAULT_INVALID", detail) from None


def format_duration(duration_ms: int) -> str:
    if duration_ms == 0:
        return "0"
    sign, rest = ("+" if duration_ms > 0 else "-"), abs(duration_ms)
    parts = []
    for unit in ("d", "h", "m", "s", "ms"):
        count, rest = divmod(rest, UNITS_MS[unit])
        parts += [f"{count}{unit}"] if count else []
    return sign + "".join(parts)
