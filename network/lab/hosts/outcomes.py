"""What a story with clients at work found, and in which case it did not go as it should."""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from network.lab.hosts.steady_clients import Kept, Seen, SteadyClients

GAP_MAX_S = 15.0
"""Longest time without finality that a story takes, for a machine that is busy with other things."""
Tell = Callable[[str], None]


class Outcome(Struct, kw_only=True):
    """What clients saw, stretch by stretch, and what was there at the end."""

    seen: list[Seen]
    kept: Kept

    def failures(self) -> list[str]:
        """What did not go as it should, in sentences."""
        found = [f"calls were refused: {seen.refused}" for seen in self.seen if seen.refused]
        found += [
            f"nothing was final for {seen.longest_gap_s:g} s" for seen in self.seen if seen.longest_gap_s > GAP_MAX_S
        ]
        lacking = {node: count for node, count in self.kept.missing.items() if count}
        return found + ([f"records are missing: {lacking}"] if lacking or not self.kept.acknowledged else [])

    def unconnected(self) -> list[str]:
        return [f"connections failed: {seen.connections_refused}" for seen in self.seen if seen.connections_refused]


def end_clients(clients: SteadyClients, tell: Tell) -> Kept:
    kept = clients.stop()
    tell(f"Of {kept.acknowledged} records that clients were told are final, nodes lack: {kept.missing}.")
    return kept


def describe(seen: Seen) -> str:
    refused = sum(seen.connections_refused.values())
    return (
        f"In {seen.seconds:.0f} s {seen.finals} calls final, the longest time without one {seen.longest_gap_s:.1f} s; "
        f"{seen.connections} new connections (p95 {seen.connect_p95_ms:.0f} ms), {refused} refused."
    )
