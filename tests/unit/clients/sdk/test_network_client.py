"""The client asks several nodes and believes none."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from clients.sdk.network_client import NetworkClient
from clients.sdk.sessions import GrantKey
from consensus.chain.block import EpochProof
from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from consensus.primitives.encoding import decode, encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state import access, records
from node.api_adapters import DecodedSnapshot
from tests.state_rows import row_of
from tests.unit.clients.sdk.conftest import make_transaction, refusal_of
from tests.unit.node.api.small_network import (
    ACCESS_ID,
    OWNER,
    RECORD_ID,
    ROBOT,
    STRANGER,
    SUBJECT,
    ManualClock,
    SmallLedger,
    flat,
    make_upload,
)

# Transactions


async def test_a_submitted_transaction_comes_back_with_a_proved_receipt(nodes: Any) -> None:
    client = nodes.client()
    nodes["n0"].node.pool.finalize_at_once = True
    receipt = await client.submit_and_wait(make_transaction(client))
    assert (receipt.ok, receipt.code, receipt.height, receipt.index, receipt.gas_used) == (True, "OK", 1, 0, 7)
    assert receipt.require_ok() is receipt


async def test_a_refused_call_is_a_receipt_that_raises_when_asked(nodes: Any) -> None:
    client, pool = nodes.client(), nodes["n0"].node.pool
    transaction = make_transaction(client)
    await client.submit(transaction)
    await pool.finalize("RECORD_ERASED")
    receipt = await client.wait_final(transaction.txid)
    assert not receipt.ok
    with pytest.raises(BlockRobotError, match="RECORD_ERASED") as refusal:
        receipt.require_ok()
    assert refusal.value.code == "CALL_REFUSED"


async def test_a_transaction_deep_in_the_chain_is_proved_from_the_blocks_above(nodes: Any) -> None:
    client, ledger = nodes.client(), nodes["n0"].node.ledger
    transaction = make_transaction(client)
    await client.submit(transaction)
    await nodes["n0"].node.pool.finalize()
    # No two blocks above it have consecutive rounds at first: the proof is found further up.
    for gap in (1, 2, 0, 0):
        await ledger.extend(gap=gap)
    receipt = await client.wait_final(transaction.txid)
    assert (receipt.height, receipt.txid) == (1, transaction.txid)


async def test_the_whole_batch_is_answered_one_by_one(nodes: Any) -> None:
    client = nodes.client()
    foreign = make_transaction(client)
    batch = [make_transaction(client), make_transaction(client), foreign]
    assert await client.submit_batch(batch) == [None, None, None]
    assert await client.submit_batch([]) == []
    assert len(set(nodes["n0"].node.pool.submissions)) == 3


async def test_who_has_a_session_at_a_node_shows_it_when_she_submits(nodes: Any) -> None:
    """Then her budget is her own, whoever else is behind her address; without one nothing is opened for it."""
    client, pool = nodes.client(), nodes["n0"].node.pool
    await client.submit(make_transaction(client))
    assert pool.sources[-1].kind == "loopback"
    (place,) = [node for node in client.nodes if node.name == "n0"]
    await client.ask_node(place, "GET", "/v1/finality", key=SUBJECT)
    await client.submit(make_transaction(client))
    assert str(pool.sources[-1]) == f"session {SUBJECT.public_key.hex()}"


async def test_sending_a_final_transaction_again_is_no_error(nodes: Any) -> None:
    client = nodes.client()
    nodes["n0"].node.pool.finalize_at_once = True
    transaction = make_transaction(client)
    first = await client.submit_and_wait(transaction)
    assert await client.submit_and_wait(transaction) == first


async def test_why_a_transaction_was_rejected_is_raised(nodes: Any) -> None:
    client = nodes.client()
    for name in ("n0", "n1"):
        nodes[name].node.pool.refuse_with = "SENDER_NOT_ADMITTED"
    assert await refusal_of(client.submit_and_wait(make_transaction(client))) == "SENDER_NOT_ADMITTED"


@pytest.mark.parametrize("code", ["CONTRACT_DISABLED", "CONTRACT_CALL_OUTDATED"])
async def test_a_contract_that_does_not_take_the_call_is_not_waited_for(
    nodes: Any, monkeypatch: pytest.MonkeyPatch, code: str
) -> None:
    client = nodes.client()
    for name in ("n0", "n1"):
        nodes[name].node.pool.refuse_with = code

    async def wait(*_: Any, **__: Any) -> None:
        raise AssertionError("nothing was accepted that could become final")

    monkeypatch.setattr(client, "wait_final", wait)
    assert await refusal_of(client.submit_and_wait(make_transaction(client))) == code


async def test_a_transaction_that_expired_everywhere_ends_the_wait(nodes: Any) -> None:
    client = nodes.client()
    for name in ("n0", "n1"):
        nodes[name].node.pool.expired.add(bytes(32))
    assert await refusal_of(client.wait_final(bytes(32))) == "TRANSACTION_EXPIRED"


async def test_a_wait_ends_at_its_time_and_names_the_transaction_to_look_up(nodes: Any) -> None:
    client = nodes.client()
    with pytest.raises(BlockRobotError, match=bytes(32).hex()) as refusal:
        await client.wait_final(bytes(32), 0)
    assert refusal.value.code == "TRANSACTION_NOT_FINAL_IN_TIME"


async def test_a_transaction_is_sent_to_another_node_while_it_is_not_final(
    nodes: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = nodes.client()
    nodes["n1"].node.pool.finalize_at_once = True

    async def run_out(*_: Any, **__: Any) -> None:
        if not nodes["n1"].node.pool.submissions:
            raise BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME")
        return await NetworkClient.wait_final(client, *_, **__)

    monkeypatch.setattr(client, "wait_final", run_out)
    transaction = make_transaction(client)
    receipt = await client.submit_and_wait(transaction)
    assert receipt.txid == transaction.txid
    assert nodes["n0"].node.pool.submissions == nodes["n1"].node.pool.submissions == [transaction.txid]


async def test_every_transaction_has_its_own_salt_and_a_limited_life(nodes: Any) -> None:
    client = nodes.client()
    first, second = make_transaction(client), make_transaction(client)
    assert first.txid != second.txid
    assert first.body.chain_id == client.genesis.chain_id
    assert first.body.valid_until_ms == client.clock.now_ms() + 120_000
    with pytest.raises(BlockRobotError, match="TRANSACTION_TOO_FAR_AHEAD"):
        client.transactions.build(SUBJECT, "a", "b", [], lifetime_ms=600_001)


# Addresses


@pytest.mark.parametrize(
    "urls", [{"n0": "http://192.0.2.1:80"}, {"elsewhere": "http://127.0.0.1:1"}, {"n0": "ftp://127.0.0.1"}, {}]
)
async def test_addresses_that_cannot_be_trusted_are_refused(nodes: Any, urls: dict[str, str]) -> None:
    genesis = nodes["n0"].node.ledger.genesis
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID:"):
        NetworkClient(genesis, urls)


# Sessions and lanes


async def test_a_session_is_opened_once_and_renewed_when_it_ends(nodes: Any) -> None:
    client, node = nodes.client(), nodes["n0"]
    for _ in range(3):
        await client.query("echo", "back", [], SUBJECT)
    assert [seen.path for seen in node.seen].count("/v1/sessions") == 1
    node.node.clock.time_ms += 600_000
    assert await client.query("echo", "back", [1], SUBJECT) == [1]
    assert [seen.path for seen in node.seen].count("/v1/sessions") == 2


async def test_a_session_that_is_about_to_end_is_renewed_beforehand(nodes: Any) -> None:
    client = nodes.client()
    await client.query("echo", "back", [], SUBJECT)
    client.clock.time_ms += 590_000
    await client.query("echo", "back", [], SUBJECT)
    assert [seen.path for seen in nodes["n0"].seen].count("/v1/sessions") == 2


async def test_the_key_of_a_grant_opens_its_sessions_as_that_grants(nodes: Any) -> None:
    key, grant_id = PrivateKey(sha256(b"one-time key")), sha256(b"grant")
    entry = row_of(access.GrantRow, owner=OWNER.public_key, grantee=key.public_key, ended_ms=1 << 50)
    await nodes["n0"].node.ledger.extend(writes={flat("access", b"grant/" + grant_id): encode_value(entry)})
    client = nodes.client(urls={"n0": nodes["n0"].url})
    assert await refusal_of(client.state_value(access.GRANT.key(grant_id), key)) == "SESSION_REFUSED"
    named = GrantKey(key, grant_id)
    assert await client.state_value(access.GRANT.key(grant_id), named) == entry
    assert await client.state_value(records.EMPTY_FRAME.key(bytes(32)), named) is None
    assert await refusal_of(client.state_value(records.EMPTY_FRAMES.key(bytes(33)), named)) == "NOT_PERMITTED"
    assert await refusal_of(client.state_value(access.GRANT.key(grant_id), key)) == "SESSION_REFUSED"
    await client.forget_key(key.public_key)
    assert await client.state_value(access.GRANT.key(grant_id), named) == entry
    assert [seen.path for seen in nodes["n0"].seen].count("/v1/sessions") == 4


async def test_two_grants_of_one_owner_to_one_key_are_each_read_in_a_session_of_its_own(nodes: Any) -> None:
    key, ids = PrivateKey(sha256(b"one-time key")), [sha256(b"grant"), sha256(b"another grant")]
    entry = row_of(access.GrantRow, owner=OWNER.public_key, grantee=key.public_key, ended_ms=1 << 50)
    writes = {flat("access", b"grant/" + grant_id): encode_value(entry) for grant_id in ids}
    await nodes["n0"].node.ledger.extend(writes=writes)
    client = nodes.client(urls={"n0": nodes["n0"].url})
    first, second = [GrantKey(key, grant_id) for grant_id in ids]
    for _ in range(2):
        assert await client.state_value(access.GRANT.key(ids[0]), first) == entry
        assert await client.state_value(access.GRANT.key(ids[1]), second) == entry
    assert [seen.path for seen in nodes["n0"].seen].count("/v1/sessions") == 2, "neither drops the other's"
    assert await refusal_of(client.state_value(access.GRANT.key(ids[1]), first)) == "NOT_PERMITTED"


async def test_a_key_without_standing_is_told_so(nodes: Any) -> None:
    assert await refusal_of(nodes.client().query("echo", "back", [], STRANGER)) == "SESSION_REFUSED"


async def test_no_two_keys_ever_meet_on_one_connection(nodes: Any) -> None:
    client = nodes.client()
    await client.query("echo", "back", [], SUBJECT)
    await client.state_value(records.VISIT.key(OWNER.public_key), OWNER)
    await client.submit(client.transactions.build(OWNER, "access", "request", [[], "care"]))
    await client.submit(make_transaction(client))
    await client.query("echo", "back", [], SUBJECT)
    seen = nodes["n0"].seen
    tokens_by_port: dict[int, set[str | None]] = {}
    for one in seen:
        tokens_by_port.setdefault(one.port, set()).add(one.token)
    assert all(len(tokens - {None}) <= 1 for tokens in tokens_by_port.values())
    submissions = [one.port for one in seen if one.path == "/v1/transactions"]
    owner_ports = {one.port for one in seen if one.path == "/v1/state-proofs"}
    assert submissions[0] in owner_ports
    assert submissions[1] not in owner_ports
    assert not any(one.cookies for one in seen)


async def test_a_forgotten_key_begins_anew_on_a_fresh_connection(nodes: Any) -> None:
    client = nodes.client()
    await client.query("echo", "back", [], OWNER)
    await client.forget_key(OWNER.public_key)
    await client.query("echo", "back", [], OWNER)
    queries = [one for one in nodes["n0"].seen if one.path == "/v1/queries"]
    assert queries[0].port != queries[1].port
    assert queries[0].token != queries[1].token


# Proved reading


async def test_values_are_proved_present_and_absent(nodes: Any) -> None:
    client = nodes.client()
    await nodes["n0"].node.ledger.extend(writes={flat("records", b"new"): encode_value([1, 2])})
    state = await client.state_values([flat("records", b"new"), flat("records", b"none")], OWNER)
    assert state.height == 1
    assert list(state.values.values()) == [[1, 2], None]
    assert (await client.newest_header(OWNER)).height == 1


async def test_a_lie_of_one_node_is_found_and_another_is_asked(nodes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from node.api.routes import proofs

    client, honest = nodes.client(), proofs.prove_keys
    calls: list[int] = []

    def lie_once(*arguments: Any) -> Any:
        calls.append(1)
        found = yield from honest(*arguments)
        if len(calls) > 1:
            return found
        from msgspec.structs import replace

        return [replace(one, value=encode_value("a lie").hex()) for one in found]

    monkeypatch.setattr(proofs, "prove_keys", lie_once)
    assert await client.state_value(records.ANNOUNCEMENT_COUNT.flat, SUBJECT) == 3
    assert len(calls) == 2
    assert [error.code for error in client.troubles.values()] == ["PROOF_INVALID"], "it is named"


async def test_no_node_can_take_a_client_back_in_time() -> None:
    from tests.unit.clients.sdk.conftest import TwoNodes

    network = TwoNodes()
    ahead, behind = await SmallLedger().start(), await SmallLedger().start()
    await network.add("n0", ahead)
    await network.add("n1", behind)
    for _ in range(2):
        await ahead.extend()
    client = network.client()
    await client.newest_header(SUBJECT)
    later = network.client(pinned=client.pinned, urls={"n1": network.urls["n1"]})
    waiting = asyncio.create_task(later.newest_header(SUBJECT))
    both = network.client(pinned=client.pinned, urls={"n1": network.urls["n1"], "n0": network.urls["n0"]})
    assert (await both.newest_header(SUBJECT)).height == 2
    assert not waiting.done()
    await behind.extend()
    await behind.extend()
    assert (await waiting).height == 2
    await network.close()


async def test_a_client_follows_the_chain_into_other_hands_by_itself(nodes: Any) -> None:
    client, ledger = nodes.client(), nodes["n0"].node.ledger
    before = make_transaction(client)
    await client.submit(before)
    await nodes["n0"].node.pool.finalize()
    for _ in range(3):
        await ledger.extend()
        await ledger.change_epoch()
    await ledger.extend()
    assert (await client.newest_header(SUBJECT)).epoch == 3
    after = make_transaction(client)
    await client.submit(after)
    await nodes["n0"].node.pool.finalize()
    await ledger.change_epoch()
    assert (await client.wait_final(before.txid)).height == 1
    assert (await client.wait_final(after.txid)).height == 9
    later = nodes.client(pinned=client.pinned)
    assert later.light_client.epoch == client.light_client.epoch
    assert await later.state_value(records.ANNOUNCEMENT_COUNT.flat, SUBJECT) == 3
    assert (await later.wait_final(before.txid)).height == 1


async def test_a_receipt_of_a_later_epoch_is_proved_to_a_client_without_a_session(nodes: Any) -> None:
    client, ledger = nodes.client(), nodes["n0"].node.ledger
    await ledger.change_epoch()
    transaction = make_transaction(client)
    await client.submit(transaction)
    await nodes["n0"].node.pool.finalize()
    assert (await client.wait_final(transaction.txid)).height == 2
    assert client.light_client.epoch.number == 1


async def test_a_forged_step_into_another_epoch_is_refused(nodes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    client, ledger = nodes.client(), nodes["n0"].node.ledger
    await ledger.change_epoch()
    await ledger.extend()
    with ledger.store.snapshot() as snapshot:
        genuine = decode(snapshot.epoch_proof(1), EpochProof)
    stolen = msgspec.structs.replace(genuine.epoch, producers=(SUBJECT.public_key,))
    forged = encode(msgspec.structs.replace(genuine, epoch=stolen))
    monkeypatch.setattr(DecodedSnapshot, "epoch_proof", lambda _self, number: forged if number == 1 else None)
    assert await refusal_of(client.newest_header(SUBJECT)) == "PROOF_INVALID"
    assert client.light_client.epoch.number == 0


async def test_announcements_are_proved_complete(nodes: Any) -> None:
    client = nodes.client()
    page = await client.announcements(0, SUBJECT, 2)
    assert (page.count, page.next_number, [item.number for item in page.items]) == (3, 2, [0, 1])
    assert page.items[1].robot == ROBOT.public_key
    page = await client.announcements(2, SUBJECT)
    assert (page.next_number, [item.view_tag for item in page.items]) == (3, [2])
    assert (await client.announcements(3, SUBJECT)).items == ()


@pytest.mark.parametrize("kept", [0, 1, 2])
async def test_a_page_that_leaves_one_out_is_refused(nodes: Any, monkeypatch: pytest.MonkeyPatch, kept: int) -> None:
    from node.api.routes import announcements

    honest = announcements.prove_keys

    def leave_out(snapshot: Any, keys: Any) -> Any:
        return (yield from honest(snapshot, keys))[: 1 + kept]

    monkeypatch.setattr(announcements, "prove_keys", leave_out)
    assert await refusal_of(nodes.client().announcements(0, SUBJECT)) == "PROOF_INVALID"


# Custodians


async def test_custodians_are_those_of_the_genesis_file(nodes: Any) -> None:
    assert [node.name for node in nodes.client().custody.custodians] == ["n0"]


async def test_a_clip_goes_up_from_the_robot_and_down_to_its_owner(nodes: Any) -> None:
    custody = nodes.client().custody
    await custody.upload_clip(custody.custodians[0], make_upload(), ROBOT)
    clip = await custody.download_clip(custody.custodians[0], RECORD_ID, ACCESS_ID, OWNER)
    assert [frame.ciphertext for frame in clip.frames] == make_upload().ciphertexts
    code = await refusal_of(custody.download_clip(custody.custodians[0], RECORD_ID, bytes(32), OWNER))
    assert code == "ACCESS_NOT_GRANTED"


async def test_an_empty_frame_is_checked_against_its_hash(nodes: Any) -> None:
    custody = nodes.client().custody
    content = bytes(1024 * 1024 + 1)
    digest = await custody.put_background(custody.custodians[0], content, ROBOT)
    assert digest == sha256(content)
    assert await custody.get_background(digest, OWNER) == content
    nodes["n0"].node.custody.backgrounds[digest] = b"changed"
    assert await refusal_of(custody.get_background(digest, OWNER)) == "UPLOAD_HASH_MISMATCH"
    assert await refusal_of(custody.get_background(bytes(32), OWNER)) == "NOT_FOUND"
    assert len(content) < CLIP_SIZE_MAX_BYTES


async def test_the_system_clock_is_used_unless_another_is_given(nodes: Any) -> None:
    async with NetworkClient(nodes["n0"].node.ledger.genesis) as client:
        assert client.clock.now_ms() > ManualClock().now_ms()
