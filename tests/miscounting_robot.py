"""A robot that contradicts itself: it seals another number of pictures to their owner than it commits to."""

from __future__ import annotations

from typing import Any

import pytest

from clients.robot import sealing
from consensus.records.metadata import RecordMetadata


def miscounting(monkeypatch: pytest.MonkeyPatch, counted: int) -> None:
    """Have every clip sealed from now on tell that it has so many frames, whatever it has. All else is as ever."""

    def lie(**fields: Any) -> RecordMetadata:
        return RecordMetadata(**fields | {"frame_count": counted})

    monkeypatch.setattr(sealing, "RecordMetadata", lie)
