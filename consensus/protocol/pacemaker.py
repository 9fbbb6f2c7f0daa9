"""Pacemaker timers for rounds and proposals, without safety; idle networks are silent (R10)."""

from __future__ import annotations

from collections import deque
from statistics import median_low

from consensus.chain.block import QuorumCertificate, TimeoutCertificate
from consensus.chain.epoch_settings import ChainSettings, parse_production
from consensus.chain.schedule import Schedule
from consensus.limits import EXECUTION_RETRY_MAX_MS, EXECUTION_RETRY_MIN_MS
from consensus.protocol.effects import (
    TIMER_ASK,
    TIMER_EXECUTE,
    TIMER_FETCH,
    TIMER_HEARTBEAT,
    TIMER_PROPOSE,
    TIMER_RESEND,
    TIMER_ROUND,
    CancelTimer,
    Effect,
    SetTimer,
)

SILENT_LEADER_DIVISOR = 4
ROUND_TRIPS_COUNT = 5
_EXPONENT_MAX = 20


def compute_timeout_ms(
    settings: ChainSettings, round_number: int, finalized_round: int, certified_above: int, round_trip_ms: int = 0
) -> int:
    """Return base * 2^k, capped (R9); k = uncertified rounds since finality.

    A round takes three delays (a call passed on, a block, votes): the base is at least that, and a quarter more than asked.
    """
    lost = (round_number - 1 - finalized_round) - certified_above
    base_ms = max(settings.base_timeout_ms, 3 * round_trip_ms // 2 + settings.base_timeout_ms // 4)
    return min(settings.timeout_cap_ms, base_ms << max(0, min(lost, _EXPONENT_MAX)))


class Pacemaker:
    """Running timers, silent leaders and due heartbeats."""

    def __init__(self, settings: ChainSettings, schedule: Schedule, before: Pacemaker | None = None) -> None:
        """`before`: the previous epoch's; the distance to the others is the same."""
        self._settings = settings
        self._schedule = schedule
        self.interval_ms = parse_production(settings.production)
        self.heartbeat_due = False
        self._silent: set[int] = set()
        trips_ms = [0] if before is None else before._round_trips_ms
        self._round_trips_ms: deque[int] = deque(trips_ms, maxlen=ROUND_TRIPS_COUNT)
        self._running: tuple[str, int] | None = None
        self._proposing: int | None = None
        self._failures_count = 0
        self._is_stopped = False

    @property
    def is_manual(self) -> bool:
        return self.interval_ms is None

    def note_tc(self, tc: TimeoutCertificate) -> None:
        """A round was lost: its leader is silent unless it timed out too."""
        leader = self._schedule.leader(tc.round)
        if all(timeout.index != leader for timeout in tc.timeouts):
            self._silent.add(leader)

    def record_message_from(self, index: int) -> None:
        self._silent.discard(index)

    def note_qc(self, qc: QuorumCertificate) -> None:
        self._silent.discard(self._schedule.leader(qc.round))

    def note_round_trip(self, elapsed_ms: int) -> None:
        """An own proposal had its quorum after so long."""
        self._round_trips_ms.append(elapsed_ms)

    def round_delay_ms(self, round_number: int, finalized_round: int, certified_above: int) -> int:
        """Return the round's wait; short after a silent leader's lost turn (R11)."""
        round_trip_ms = median_low(self._round_trips_ms)
        delay = compute_timeout_ms(self._settings, round_number, finalized_round, certified_above, round_trip_ms)
        if self._schedule.leader(round_number) in self._silent:
            delay = max(1, delay // SILENT_LEADER_DIVISOR)
        return delay + (self.interval_ms or 0)

    def heartbeat(self) -> list[Effect]:
        self.heartbeat_due = False
        if self.is_manual:
            return []
        return [SetTimer(kind=TIMER_HEARTBEAT, round=0, delay_ms=self._settings.heartbeat_ms)]

    def stop(self) -> list[Effect]:
        if self._is_stopped:
            return []
        self._is_stopped = True
        kinds = (TIMER_ROUND, TIMER_RESEND, TIMER_HEARTBEAT, TIMER_PROPOSE, TIMER_FETCH, TIMER_ASK, TIMER_EXECUTE)
        return [CancelTimer(kind=kind) for kind in kinds]

    def fired(self, kind: str) -> None:
        if self._running is not None and self._running[0] == kind:
            self._running = None
        if kind == TIMER_PROPOSE:
            self._proposing = None
        if kind == TIMER_HEARTBEAT:
            self.heartbeat_due = True

    def wait_to_propose(self, round_number: int, delay_ms: int) -> list[Effect]:
        if self._proposing == round_number or self.is_manual:
            return []
        self._proposing = round_number
        return [SetTimer(kind=TIMER_PROPOSE, round=round_number, delay_ms=max(1, delay_ms))]

    def wait_to_execute(self) -> list[Effect]:
        delay_ms = min(EXECUTION_RETRY_MAX_MS, EXECUTION_RETRY_MIN_MS << min(self._failures_count, _EXPONENT_MAX))
        self._failures_count += 1
        return [SetTimer(kind=TIMER_EXECUTE, round=0, delay_ms=delay_ms)]

    def note_executed(self) -> None:
        self._failures_count = 0

    def run(self, round_number: int, *, busy: bool, timed_out: bool, delay_ms: int) -> list[Effect]:
        wanted: tuple[str, int] | None = None
        if busy and not self.is_manual:
            wanted = (TIMER_RESEND if timed_out else TIMER_ROUND, round_number)
        if wanted == self._running:
            return []
        effects: list[Effect] = []
        if self._running is not None and (wanted is None or wanted[0] != self._running[0]):
            effects.append(CancelTimer(kind=self._running[0]))
        if wanted is not None:
            delay = self._settings.base_timeout_ms if timed_out else delay_ms
            effects.append(SetTimer(kind=wanted[0], round=round_number, delay_ms=delay))
        self._running = wanted
        return effects
