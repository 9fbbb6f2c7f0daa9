"""The keys of grants at the interface: bounded together for a visit, and after the end for what became of the records."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.chain.session_message import sign_session
from consensus.errors import BlockRobotError
from consensus.limits import GRANT_NOTICE_MS
from consensus.primitives.encoding import encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state.access import GrantRow
from consensus.state.records import VisitRow
from node.api.access import sessions
from node.api.access.sessions import SESSIONS_OF_KEY_MAX_COUNT, SessionTable
from tests.state_rows import row_of, stored
from tests.unit.node.api.small_network import OWNER, RECORD_ID, SUBJECT, SmallNode, flat

OTHER_VISIT = PrivateKey(sha256(b"other visit")).public_key


def key_of(number: int) -> PrivateKey:
    return PrivateKey(sha256(b"one-time key %d" % number))


def id_of(number: int) -> bytes:
    return sha256(b"grant %d" % number)


async def share(node: SmallNode, *numbers: int, ended_ago_ms: int = -60_000) -> None:
    """Finalize that something of the visit is shared with these keys."""
    ended_ms = node.ledger.header.timestamp_ms - ended_ago_ms
    entry = row_of(GrantRow, owner=OWNER.public_key, records=[RECORD_ID], ended_ms=ended_ms)
    writes = {
        flat("access", b"grant/" + id_of(each)): encode_value(entry | {"grantee": key_of(each).public_key})
        for each in numbers
    }
    await node.ledger.extend(writes=writes)


def open_in(table: SessionTable, node: SmallNode, key: PrivateKey, grant_id: bytes = b"") -> bytes:
    challenge, _ = table.challenge(key.public_key)
    signature = sign_session(key, node.ledger.genesis.chain_id, "n0", challenge)
    return table.open(key.public_key, challenge, signature, grant_id)[0]


async def test_the_grantees_of_one_visit_close_nobody_elses_sessions(
    node: SmallNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever has a visit makes as many keys of grants as she likes: they are counted as one."""
    monkeypatch.setattr(sessions, "SESSIONS_MAX_COUNT", 2 * SESSIONS_OF_KEY_MAX_COUNT)
    await share(node, *range(4))
    table = SessionTable(node.ledger.genesis.chain_id, "n0", node.clock, node.services.ledger)
    member, owner = open_in(table, node, SUBJECT), open_in(table, node, OWNER)
    modest = open_in(table, node, key_of(0), id_of(0))
    for number in (1, 2, 3):
        for _ in range(SESSIONS_OF_KEY_MAX_COUNT):
            open_in(table, node, key_of(number), id_of(number))
    assert table.resolve(member).kind == "member"
    assert table.resolve(owner).kind == "owner"
    assert table.resolve(modest).kind == "grantee", "nor does one grantee close another's, who has fewer"


async def read(api: Any, headers: dict[str, str], *keys: bytes) -> int:
    answer = await api.post("/v1/state-proofs", json={"keys": [key.hex() for key in keys]}, headers=headers)
    return int(answer.status)


async def test_after_the_end_only_what_became_of_the_records_is_read(
    api: Any, node: SmallNode, open_session: Any
) -> None:
    await share(node, 0, ended_ago_ms=1)
    headers = await open_session(key_of(0), id_of(0))
    own = [
        flat("access", b"grant/" + id_of(0)),
        flat("records", b"record/" + RECORD_ID),
        flat("rights", b"restriction/" + OWNER.public_key),
        flat("audit", b"entry/" + OWNER.public_key + bytes(4)),
        flat("membership", b"nodes"),
    ]
    assert await read(api, headers, *own) == 200
    assert (await api.get("/v1/finality", headers=headers)).status == 200
    foreign = [
        flat("access", b"grant-number/" + bytes(8)),
        flat("records", b"announcement/" + bytes(8)),
        flat("records", b"visit/" + OTHER_VISIT),
        flat("identity", b"member/" + SUBJECT.public_key),
    ]
    for key in foreign:
        assert await read(api, headers, own[0], key) == 403, key
    for path in (f"/v1/backgrounds/{'00' * 32}", "/v1/blocks", "/v1/announcements"):
        assert (await api.get(path, headers=headers)).status == 403, path
    query = {"contract": "echo", "view": "back", "args": encode_value([]).hex()}
    assert (await api.post("/v1/queries", json=query, headers=headers)).status == 403


async def test_while_the_grant_stands_its_key_reads_what_is_of_its_visit_and_who_the_custodians_are(
    api: Any, node: SmallNode, open_session: Any
) -> None:
    """Whoever left keeps the key of a grant until it ends, and nobody can tell that it is she."""
    await share(node, 0)
    headers = await open_session(key_of(0), id_of(0))
    own = [
        flat("records", b"record/" + RECORD_ID),
        flat("records", b"current/" + OWNER.public_key),
        flat("membership", b"node/n0"),
        flat("identity", b"custodians"),
        flat("identity", b"custodian/" + SUBJECT.public_key),
    ]
    assert await read(api, headers, *own) == 200
    foreign = [
        flat("records", b"visit/" + OTHER_VISIT),
        flat("identity", b"member/" + SUBJECT.public_key),
        flat("identity", b"handle/" + bytes(32)),
        flat("access", b"grant-number/" + bytes(8)),
    ]
    for key in foreign:
        assert await read(api, headers, own[0], key) == 403, key
    query = {"contract": "echo", "view": "back", "args": encode_value([]).hex()}
    assert (await api.post("/v1/queries", json=query, headers=headers)).status == 403


async def test_at_its_end_a_grant_has_ended(node: SmallNode) -> None:
    before_ms = node.ledger.header.timestamp_ms
    await node.ledger.extend()
    await share(node, 0, ended_ago_ms=before_ms - node.ledger.header.timestamp_ms)
    table = SessionTable(node.ledger.genesis.chain_id, "n0", node.clock, node.services.ledger)
    assert table.resolve(open_in(table, node, key_of(0), id_of(0))).kind == "former-grantee"


async def test_long_after_the_end_there_is_no_session(api: Any, node: SmallNode, open_session: Any) -> None:
    await share(node, 0, ended_ago_ms=1)
    headers = await open_session(key_of(0), id_of(0))
    await share(node, 0, ended_ago_ms=GRANT_NOTICE_MS)
    answer = await api.get("/v1/finality", headers=headers)
    assert (answer.status, (await answer.json())["code"]) == (403, "SESSION_REFUSED")


async def test_a_key_is_a_grantees_only_of_the_grant_that_it_names(node: SmallNode) -> None:
    """So neither a visit that a robot opens under her key, nor another grant to it, is in her way."""
    await share(node, 0, 1)
    await node.ledger.extend(writes={flat("records", b"visit/" + key_of(0).public_key): stored(VisitRow)})
    table = SessionTable(node.ledger.genesis.chain_id, "n0", node.clock, node.services.ledger)
    assert table.resolve(open_in(table, node, key_of(0), id_of(0))).kind == "grantee"
    assert table.resolve(open_in(table, node, key_of(0))).kind == "owner"
    for key, grant_id in ((key_of(0), id_of(1)), (key_of(1), b""), (key_of(1), bytes(32))):
        with pytest.raises(BlockRobotError, match="SESSION_REFUSED"):
            open_in(table, node, key, grant_id)
