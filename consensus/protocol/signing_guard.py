"""Decides whether a restarted producer may sign: above possibly signed rounds (R40), locked out after memory loss (R34,
R35).
"""

from __future__ import annotations

from typing import NamedTuple

from consensus.chain.block import Header
from consensus.chain.journal_records import LOCKOUT_OUTDATED, SigningLockout
from consensus.chain.messages import ASKING, LOCKED_OUT, SIGNING, LastSignedRequest, LastSignedResponse
from consensus.chain.schedule import Schedule
from consensus.protocol.effects import TIMER_ASK, Broadcast, CancelTimer, Effect, LockoutChanged, SendTo, SetTimer

_FIRST_ROUND = 1


class LockoutStatus(NamedTuple):
    """Why a producer signs nothing, the end of "it signs nothing until ...", and whether that can come."""

    reason: str
    until: str
    can_end: bool = True


class SigningGuard:
    """A producer's return in one epoch; followers and lone producers need none."""

    def __init__(
        self,
        schedule: Schedule,
        index: int | None,
        base_timeout_ms: int,
        lockout: SigningLockout | None,
        *,
        asks: bool = True,
        signs_above_round: int = 0,
    ) -> None:
        """Begin with the journal's lockout; `asks` is False only after signing in the previous epoch (R36).

        `signs_above_round` bounds what may be forgotten then (R40).
        """
        self._epoch, self._retry_ms = schedule.epoch, base_timeout_ms
        self._producers = frozenset(schedule.producers)
        self._tolerated = schedule.faults_tolerated
        self._is_alone = index is not None and len(schedule.producers) == 1
        self._has_others = index is not None and not self._is_alone
        self._needed_to_sign = schedule.quorum - 1
        self._needed_for_round = 2 * schedule.faults_tolerated + 1
        self._is_asking = asks and self._has_others
        self._asked_at_ms = -1
        self._willing: set[int] = set()
        self._locked_out: set[int] = set()
        self._signed_rounds: dict[int, int] = {}
        self._highest_told_round = 0
        self.signs_above_round = signs_above_round
        self.lockout = _carried(lockout, schedule.epoch, same_producers=False)

    @property
    def signing_state(self) -> str:
        if self.lockout is not None and self._has_others:
            return LOCKED_OUT
        return ASKING if self._is_asking else SIGNING

    @property
    def is_blocking(self) -> bool:
        return self._has_others and (self._is_asking or self.lockout is not None)

    @property
    def is_waiting(self) -> bool:
        return self._is_asking or (self._has_others and self.lockout is not None and self.lockout.above_round is None)

    @property
    def report(self) -> LockoutStatus | None:
        if not self.is_blocking:
            return None
        lockout = self.lockout
        if lockout is None:
            needed = f"{self._needed_to_sign} other producers have said what they last heard of this one"
            return LockoutStatus(ASKING, f"{needed} ({len(self._willing)} so far)")
        if lockout.above_round is not None:
            until = f"a block above round {lockout.above_round} of epoch {lockout.epoch} is final without it"
        else:
            needed = f"{self._needed_for_round} other producers that may sign have told their last round"
            until = f"{needed} ({len(self._signed_rounds)} so far) and a block above it is final"
        can_end = 1 + len(self._locked_out) <= self._tolerated
        if not can_end:
            until += (
                f" (which cannot be while {1 + len(self._locked_out)} of {len(self._producers)} producers are locked out:"
                f" the chain tolerates {self._tolerated})"
            )
        return LockoutStatus(lockout.reason, until, can_end)

    # Asking

    def begin(self, now_ms: int) -> list[Effect]:
        """R33: ask everybody; `now_ms` identifies this run's answers."""
        self._asked_at_ms = now_ms
        if not self.is_blocking:
            return []
        return [self._changed(), *self.ask_again()]

    def ask_again(self) -> list[Effect]:
        if not self.is_waiting:
            return []
        return [Broadcast(self._request()), SetTimer(kind=TIMER_ASK, round=0, delay_ms=self._retry_ms)]

    def ask(self, index: int) -> list[Effect]:
        return [SendTo(index=index, message=self._request())] if self.is_waiting else []

    def _request(self) -> LastSignedRequest:
        return LastSignedRequest(epoch=self._epoch, asked_at_ms=self._asked_at_ms)

    def is_answer(self, answer: LastSignedResponse) -> bool:
        return self.is_waiting and (answer.epoch, answer.asked_at_ms) == (self._epoch, self._asked_at_ms)

    def take(self, sender: int, answer: LastSignedResponse, last_voted_round: int) -> list[Effect]:
        before = (self._is_asking, self.lockout)
        self._willing.discard(sender)
        self._locked_out.discard(sender)
        self._signed_rounds.pop(sender, None)
        if answer.signing_state == LOCKED_OUT:
            self._locked_out.add(sender)
        else:
            self._willing.add(sender)
            self._highest_told_round = max(self._highest_told_round, answer.signed_round)
        if answer.signing_state == SIGNING:
            self._signed_rounds[sender] = answer.signed_round
        if self._is_asking and len(self._willing) >= self._needed_to_sign:
            self._is_asking = False
            self.signs_above_round = self._first_safe_round() - 1
        lockout = self.lockout
        if lockout is not None and lockout.above_round is None and len(self._signed_rounds) >= self._needed_for_round:
            above_round = 1 + max(last_voted_round, *self._signed_rounds.values())
            self.lockout = SigningLockout(reason=lockout.reason, epoch=self._epoch, above_round=above_round)
        if before == (self._is_asking, self.lockout):
            return []
        effects: list[Effect] = [self._changed()]
        if not self.is_waiting:
            effects.append(CancelTimer(kind=TIMER_ASK))
        return effects

    def _first_safe_round(self) -> int:
        """R40: a quorum, overlapping those asked, led into every possibly signed round."""
        is_beginning = self._epoch == 0 and self._highest_told_round == 0
        return _FIRST_ROUND if is_beginning else self._highest_told_round + 2

    # Lockout

    def lock_out(self, forgotten_round: int) -> list[Effect]:
        lockout = self.lockout
        if not self._has_others:
            return []
        if lockout is not None and (lockout.above_round is None or forgotten_round <= lockout.above_round):
            return []
        self.lockout = SigningLockout(reason=LOCKOUT_OUTDATED, epoch=self._epoch, above_round=None)
        self._signed_rounds.clear()
        return [self._changed(), *self.ask_again()]

    def may_end(self, finalized: Header) -> bool:
        """R35: return whether the chain passed every possibly signed round."""
        lockout = self.lockout
        if lockout is None or self._is_alone:
            return lockout is not None
        is_above = lockout.above_round is not None and finalized.round > lockout.above_round
        return is_above and finalized.epoch == self._epoch == lockout.epoch

    def end(self) -> list[Effect]:
        self.lockout = None
        return [self._changed()]

    def _changed(self) -> Effect:
        report = self.report
        return LockoutChanged(reason="", until="") if report is None else LockoutChanged(report.reason, report.until)

    # The next epoch

    def next(self, schedule: Schedule, index: int | None, base_timeout_ms: int, *, boundary_round: int) -> SigningGuard:
        """R36: return the next epoch's guard; who spoke here need not ask, unless producers change after a low boundary
        (R40).
        """
        is_following = schedule.epoch == self._epoch + 1
        same_producers = is_following and self._producers == frozenset(schedule.producers)
        may_have_left = boundary_round <= self.signs_above_round
        spoke = self._has_others and not self._is_asking and (same_producers or not may_have_left)
        lockout = _carried(self.lockout, schedule.epoch, same_producers=same_producers)
        signs_above_round = _FIRST_ROUND if spoke and may_have_left else 0
        return SigningGuard(
            schedule, index, base_timeout_ms, lockout, asks=not spoke, signs_above_round=signs_above_round
        )


def _carried(lockout: SigningLockout | None, epoch: int, *, same_producers: bool) -> SigningLockout | None:
    """R36: with changed producers or unknown rounds ask again."""
    if lockout is None or lockout.epoch >= epoch:
        return lockout
    is_bounded = same_producers and lockout.above_round is not None
    return SigningLockout(reason=lockout.reason, epoch=epoch, above_round=_FIRST_ROUND if is_bounded else None)
