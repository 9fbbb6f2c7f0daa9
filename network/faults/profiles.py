"""Link kinds by name; figures are per direction, so a round trip doubles the delay."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.errors import BlockRobotError
from node.p2p.shaping import LinkFault


@dataclass(frozen=True, slots=True)
class LinkProfile:
    """A kind of link and its meaning."""

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
