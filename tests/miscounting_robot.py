"""A robot that contradicts itself: it seals other pictures to their owner, or another number, than it commits to."""

from __future__ import annotations

from typing import Any

import pytest
from nacl.public import PrivateKey

from clients.robot.recording import sealing
from consensus.records.commitments import frame_commitment
from consensus.records.envelopes import seal_data_key
from consensus.records.metadata import RecordMetadata


def miscounting(monkeypatch: pytest.MonkeyPatch, counted: int) -> None:
    """Have every clip sealed from now on tell that it has so many frames, whatever it has. All else is as ever."""

    def lie(**fields: Any) -> RecordMetadata:
        return RecordMetadata(**fields | {"frame_count": counted})

    monkeypatch.setattr(sealing, "RecordMetadata", lie)


def committing_otherwise(monkeypatch: pytest.MonkeyPatch, place: int) -> None:
    """Have every clip sealed from now on commit to another picture at this index than the one that is sealed."""

    def lie(data_key: bytes, index: int, plaintext: bytes) -> bytes:
        return frame_commitment(data_key, index, plaintext + b"other" if index == place else plaintext)

    monkeypatch.setattr(sealing, "frame_commitment", lie)


def committing_to_nothing_readable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every clip sealed from now on hold bytes that are no rendition, and commit to them."""
    monkeypatch.setattr(sealing, "encode_rendition", lambda _: b"no rendition")


def sealing_to_somebody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the keys of every clip sealed from now on open with nobody's key that the test knows."""
    other = bytes(PrivateKey.generate().public_key)
    monkeypatch.setattr(sealing, "seal_data_key", lambda _, data_key: seal_data_key(other, data_key))
