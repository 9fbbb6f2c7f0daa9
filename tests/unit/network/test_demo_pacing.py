"""Where each line stays, a long stage does not drown what was checked."""

from __future__ import annotations

from network.demo.checks import LINE_EVERY_S, ProgressThrottle


def test_a_stage_speaks_now_and_then_and_another_one_at_once() -> None:
    pace = ProgressThrottle()
    passed = [now for now in range(21) if pace.lets_pass(f"recording: {now} frames seen", float(now))]
    assert passed == [0, 5, 10, 15, 20]
    assert not pace.lets_pass("recording: 21 frames seen", 20.0 + LINE_EVERY_S / 2)
    pace = ProgressThrottle()
    lines = ["recording: 1 frame seen", "killing the leading node", "killing the leading node", "erasing: 1 of 2"]
    assert [pace.lets_pass(line, 1.0) for line in lines] == [True] * 4
