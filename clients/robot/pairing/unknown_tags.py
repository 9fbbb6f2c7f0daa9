"""Counts tags not on the roster, hashed under a per-run key."""

from __future__ import annotations

import hashlib
import secrets

from clients.robot.run.run_summary import UnknownTagCounts

TAGS_MAX_COUNT = 4_096
"""So many are told apart; readings of further ones are counted, the tags are not."""

_DIGEST_BYTES = 16


class UnknownTags:
    """One run's readings of tags unknown to the roster."""

    def __init__(self) -> None:
        self._key = secrets.token_bytes(32)
        self._tags: set[bytes] = set()
        self._has_more = False
        self.readings_count = 0

    def note(self, uid: str) -> None:
        self.readings_count += 1
        tag = hashlib.blake2b(uid.encode(), key=self._key, digest_size=_DIGEST_BYTES).digest()
        if tag in self._tags:
            return
        if len(self._tags) < TAGS_MAX_COUNT:
            self._tags.add(tag)
        else:
            self._has_more = True

    def summarise(self) -> UnknownTagCounts:
        return UnknownTagCounts(readings=self.readings_count, tags=len(self._tags), more_tags=self._has_more)
