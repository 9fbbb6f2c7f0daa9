"""From when on a node could catch up is read from its own log."""

from __future__ import annotations

from datetime import UTC, datetime

from network.bench.catch_up import read_first_link

LOG = """
{"event": "peer_connected", "timestamp": "2026-01-01T10:00:00.000000Z"}
{"event": "node_started", "timestamp": "2026-01-01T10:05:00.000000Z"}
{"event": "peer_connected", "timestamp": "2026-01-01T10:05:01.250000Z"}
{"event": "peer_connected", "timestamp": "2026-01-01T10:05:02.000000Z"}
""".strip()


def test_the_first_link_after_the_restart_counts() -> None:
    since = datetime(2026, 1, 1, 10, 4, tzinfo=UTC)
    assert read_first_link(LOG, since) == datetime(2026, 1, 1, 10, 5, 1, 250_000, tzinfo=UTC)
    assert read_first_link(LOG, datetime(2026, 1, 1, 11, tzinfo=UTC)) is None
