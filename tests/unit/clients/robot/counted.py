"""Counts of open visits as a whole robot leaves them, without its clips."""

from __future__ import annotations

from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore


def note(visits: UnclosedVisitStore, owner: bytes, sealed_count: int) -> None:
    """Seal and spool as many clips of a visit as there are to be with those before, and save the count.

    0: one that was destroyed again.
    """
    before = visits.counts.get(owner, 0)
    visits.count(owner, max(1, sealed_count))
    for number in range(visits.counts[owner] - before):
        visits.spooled(owner, f"{number + 1:012d}.clip")
    if not sealed_count:
        visits.lower(owner)
    visits.save()
