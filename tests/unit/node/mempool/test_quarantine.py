"""What failed here is left out for a while that grows; what was lost with an own block for less long; nothing for ever."""

from __future__ import annotations

import pytest

from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from node.mempool.quarantine import HELD_MAX_COUNT, LOST_PAUSES_MS, PAUSES_MS, REASON_MAX_CHARS, Quarantine

ONE, OTHER = b"1" * 32, b"2" * 32


class Watch:
    """Seconds that a test sets."""

    def __init__(self) -> None:
        self.now_s = 1_000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def watch() -> Watch:
    return Watch()


@pytest.fixture
def quarantine(watch: Watch) -> Quarantine:
    return Quarantine(watch)


def test_each_failure_holds_a_transaction_longer(quarantine: Quarantine, watch: Watch) -> None:
    for pause_ms in (*PAUSES_MS, PAUSES_MS[-1]):
        quarantine.note_failure(ONE, "it ended by signal 9")
        assert quarantine.held() == {ONE}
        watch.now_s += pause_ms / 1000 - 0.1
        assert quarantine.held() == {ONE}
        watch.now_s += 0.2
        assert quarantine.held() == frozenset()


def test_a_loss_holds_less_long_than_a_failure_and_shortens_none(quarantine: Quarantine, watch: Watch) -> None:
    for _ in range(5):
        quarantine.note_lost([ONE, OTHER])
    assert quarantine.held() == {ONE, OTHER}
    assert quarantine.find_failing([ONE, OTHER]) is None
    watch.now_s += LOST_PAUSES_MS[-1] / 1000 + 0.1
    assert quarantine.held() == frozenset()
    for _ in range(3):
        quarantine.note_failure(ONE, "")
    quarantine.note_lost([ONE])
    watch.now_s += TRANSACTION_LIFETIME_MAX_MS / 1000 - 1
    assert quarantine.held() == {ONE}


def test_what_failed_is_tried_again_after_a_while_and_not_before(quarantine: Quarantine, watch: Watch) -> None:
    quarantine.note_failure(ONE, "")
    assert quarantine.find_failing([OTHER, ONE]) == ONE
    watch.now_s += PAUSES_MS[0] / 1000 + 1
    assert quarantine.find_failing([OTHER, ONE]) is None
    quarantine.note_change(("visitors", 2), "MemoryError")
    assert quarantine.has_failed(("visitors", 2))
    assert not quarantine.has_failed(("visitors", 3))
    watch.now_s += TRANSACTION_LIFETIME_MAX_MS / 1000 + 1
    assert not quarantine.has_failed(("visitors", 2))


def test_what_is_remembered_is_bounded(quarantine: Quarantine) -> None:
    quarantine.note_lost(number.to_bytes(32) for number in range(HELD_MAX_COUNT + 5))
    assert len(quarantine.held()) == HELD_MAX_COUNT
    for number in range(200):
        quarantine.note_change((f"c{number}", 1), "")
        quarantine.note_block(number.to_bytes(32), number, "", certified=True)
    assert not quarantine.has_failed(("c0", 1))
    assert quarantine.has_failed(("c199", 1))
    assert quarantine.failures_of(bytes(32)) == 0


def test_losses_push_out_no_failure(quarantine: Quarantine, watch: Watch) -> None:
    for _ in range(3):
        quarantine.note_failure(ONE, "")
    quarantine.note_lost(number.to_bytes(32) for number in range(HELD_MAX_COUNT + 5))
    assert ONE in quarantine.held()
    assert quarantine.find_failing([ONE]) == ONE
    watch.now_s += PAUSES_MS[0] / 1000 + 1
    assert quarantine.find_failing([ONE]) == ONE


def test_only_blocks_that_others_could_execute_are_told(quarantine: Quarantine) -> None:
    quarantine.note_block(ONE, 7, "x", certified=False)
    assert quarantine.describe()["stuck"] is None
    quarantine.note_block(ONE, 7, "x", certified=True)
    quarantine.note_block(OTHER, 8, "x", certified=True)
    assert quarantine.describe()["stuck"] == {"height": 7, "attempts": 2}
    assert quarantine.failures_of(ONE) == 2
    quarantine.forget_up_to(7)
    assert quarantine.describe()["stuck"] == {"height": 8, "attempts": 1}
    quarantine.forget_block(OTHER)
    assert quarantine.describe()["stuck"] is None


def test_a_reason_is_short_and_harmless_for_a_terminal(quarantine: Quarantine) -> None:
    quarantine.note_failure(ONE, "\x1b[2J\u202e\n" + "x" * 1_000)
    assert quarantine.last_failure.startswith("?[2J??x")
    assert len(quarantine.last_failure) == REASON_MAX_CHARS
