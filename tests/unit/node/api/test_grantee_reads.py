"""What the key of a grant may read of the state: its visit and its records, and no other person's."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.state.access import GrantRow
from node.api.access.principals import require_readable
from tests.state_rows import row_of

NOW_MS, ENDED_MS = 1_000_000, 2_000_000
GRANT_ID, READER, OWNER, RECORD = bytes(32), b"r" * 33, b"o" * 33, b"1" * 16
GRANT = row_of(GrantRow, grantee=READER, owner=OWNER, records=[RECORD], ended_ms=ENDED_MS)
OWN = [
    b"records\x00record/" + RECORD,
    b"records\x00visit/" + OWNER,
    b"access\x00grant/" + GRANT_ID,
    b"membership\x00nodes",
]
WHILE_IT_STANDS = [b"identity\x00custodians", b"records\x00empty-frame/" + b"e" * 32]
OTHERS = [b"records\x00record/" + b"2" * 16, b"identity\x00member/" + b"m" * 32, b"consent\x00steps/" + b"m" * 32]


def snapshot(grant: dict[str, Any] | None = GRANT) -> Any:
    """A ledger at NOW_MS that holds this grant alone."""
    held = {} if grant is None else {b"access\x00grant/" + GRANT_ID: encode_value(grant)}
    return SimpleNamespace(get=held.get, header=SimpleNamespace(timestamp_ms=NOW_MS))


def refusal(ledger: Any, kind: Any, *keys: bytes, reader: bytes = READER) -> str | None:
    try:
        require_readable(ledger, kind, reader, GRANT_ID, keys)
    except BlockRobotError as error:
        return error.code
    return None


@pytest.mark.parametrize("kind", ["grantee", "former-grantee"])
def test_what_is_of_the_visit_and_its_records_is_read(kind: str) -> None:
    assert refusal(snapshot(), kind, *OWN) is None


@pytest.mark.parametrize("kind", ["grantee", "former-grantee"])
@pytest.mark.parametrize("key", OTHERS)
def test_what_is_of_anybody_else_is_refused_also_beside_what_is_own(kind: str, key: bytes) -> None:
    assert refusal(snapshot(), kind, *OWN, key) == "NOT_PERMITTED"


def test_custodians_and_empty_frames_are_read_while_the_grant_of_this_very_key_stands() -> None:
    assert refusal(snapshot(), "grantee", *WHILE_IT_STANDS) is None
    assert [refusal(snapshot(), "former-grantee", key) for key in WHILE_IT_STANDS] == ["NOT_PERMITTED"] * 2
    assert refusal(snapshot(None), "grantee", *OWN) == "NOT_PERMITTED"
    assert refusal(snapshot(), "grantee", *OWN, reader=b"x" * 33) == "NOT_PERMITTED"
    assert refusal(snapshot(None), "member", *OTHERS) is None
