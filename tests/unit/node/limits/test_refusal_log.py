"""What is refused is told to the operator, and no flood of one kind hides another or fills the log."""

from __future__ import annotations

from structlog.testing import capture_logs

from consensus.errors import BlockRobotError
from node.limits.refusal_log import LINES_OF_KIND_MAX_COUNT, REFUSALS_KEPT_COUNT, REPEAT_LOG_MS, RefusalLog

REFUSAL = BlockRobotError("RATE_LIMITED")


def test_many_addresses_push_no_peer_out() -> None:
    refusals = RefusalLog("over_budget")
    refusals.note("peer node-2", REFUSAL, 0, "peer")
    for number in range(10 * REFUSALS_KEPT_COUNT):
        refusals.note(f"address 192.0.2.{number}", REFUSAL, number, "address")
    told = [row["peer"] for row in refusals.describe(1_000)]
    assert "peer node-2" in told
    assert len(told) == 1 + REFUSALS_KEPT_COUNT
    refusals.forget("peer node-2")
    assert "peer node-2" not in [row["peer"] for row in refusals.describe(1_000)]


def test_a_flood_from_ever_new_addresses_makes_no_flood_of_lines() -> None:
    refusals = RefusalLog("over_budget")
    with capture_logs() as lines:
        for number in range(1_000):
            refusals.note(f"address 192.0.2.{number}", REFUSAL, 5_000, "address")
        refusals.note("peer node-2", REFUSAL, 5_000, "peer")
        refusals.note("address 192.0.2.1", BlockRobotError("PEER_REFUSED"), 5_000 + REPEAT_LOG_MS, "address")
    assert len(lines) == LINES_OF_KIND_MAX_COUNT + 2
    assert lines[-2]["peer"] == "peer node-2"
    assert lines[-1]["left_out"] == 1_000 - LINES_OF_KIND_MAX_COUNT


def test_refusals_for_two_reasons_in_turn_are_counted_each_and_logged_once() -> None:
    refusals = RefusalLog("over_budget")
    with capture_logs() as lines:
        for number in range(100):
            refusals.note("member ab", BlockRobotError(("RATE_LIMITED", "SENDER_LIMIT")[number % 2]), number, "member")
    assert len(lines) == 2
    told = [(row["code"], row["count"], row["since_ms"]) for row in refusals.describe(100)]
    assert told == [("RATE_LIMITED", 50, 0), ("SENDER_LIMIT", 50, 1)]
