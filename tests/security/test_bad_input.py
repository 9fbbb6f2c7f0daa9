"""Whatever a node is sent, it answers with a code, a sentence and a next step, and nothing is half-written."""

from __future__ import annotations

import asyncio
import gzip
import io
import secrets

import msgspec
import pytest

from consensus.chain.transaction import Transaction, TransactionWire
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS, TRANSACTION_SIZE_MAX_BYTES
from consensus.primitives.encoding import encode
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import MSGPACK, Intruder, new_key, new_member, nothing_changes, now_ms

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.smoke]

_ORDER = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141


def _with_signature(transaction: Transaction, signature: bytes) -> bytes:
    return encode(TransactionWire(body=transaction.body_bytes, signature=signature))


def _high_s(signature: bytes) -> bytes:
    """The other valid signature over the same bytes, which malleability would allow."""
    s = _ORDER - int.from_bytes(signature[32:64], "big")
    return signature[:32] + s.to_bytes(32, "big") + bytes([signature[64] ^ 1])


# Transactions


async def test_damaged_bytes_are_no_transaction(network: NetworkUnderTest, intruder: Intruder) -> None:
    good = network.transaction()
    async with nothing_changes(network):
        for wire in (
            b"",
            b"\xc1",
            good.wire[:-1],
            good.wire[: len(good.wire) // 2],
            good.wire + b"\x00",
            b"\x91" * 8000,
        ):
            (result,) = await intruder.submit(wire)
            assert result["error"]["code"] in {"ENCODING_INVALID", "ENCODING_NOT_CANONICAL"}
            assert result["txid"] is None


async def test_a_transaction_has_one_form_and_a_largest_size(network: NetworkUnderTest, intruder: Intruder) -> None:
    """The same fields in longer MessagePack forms would be a second wire with the same meaning."""
    good = network.transaction()
    outer_long = b"\xdc\x00\x02" + good.wire[1:]
    body_long = encode(TransactionWire(body=b"\xdc\x00\x08" + good.body_bytes[1:], signature=good.signature))
    async with nothing_changes(network):
        for wire in (outer_long, body_long):
            await intruder.rejected("ENCODING_NOT_CANONICAL", wire)
    large = network.transaction(arguments=[bytes(TRANSACTION_SIZE_MAX_BYTES)])
    async with nothing_changes(network):
        await intruder.rejected("TRANSACTION_TOO_LARGE", large.wire)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"chain_id": bytes(32)}, "TRANSACTION_WRONG_CHAIN"),
        ({"valid_until_ms": 1}, "TRANSACTION_EXPIRED"),
        ({"valid_until_ms": -60_000}, "TRANSACTION_EXPIRED"),
        ({"valid_until_ms": TRANSACTION_LIFETIME_MAX_MS + 30_000}, "TRANSACTION_TOO_FAR_AHEAD"),
        ({"valid_until_ms": (1 << 53) - 1}, "TRANSACTION_TOO_FAR_AHEAD"),
    ],
)
async def test_another_chain_or_time_is_refused(
    network: NetworkUnderTest, intruder: Intruder, changes: dict[str, int], code: str
) -> None:
    until = changes.get("valid_until_ms")
    if until is not None and until not in {1, (1 << 53) - 1}:
        changes = {"valid_until_ms": now_ms() + until}
    async with nothing_changes(network):
        await intruder.rejected(code, network.transaction(**changes).wire)


async def test_signatures_that_are_not_the_senders_are_refused(network: NetworkUnderTest, intruder: Intruder) -> None:
    good, other = network.transaction(), network.transaction()
    flipped = bytes([good.signature[0] ^ 1]) + good.signature[1:]
    async with nothing_changes(network):
        for signature in (
            other.signature,
            flipped,
            bytes(65),
            b"\xff" * 32 + bytes(32) + b"\x00",
            good.signature[:64] + b"\x09",
        ):
            await intruder.rejected("SENDER_NOT_ADMITTED", _with_signature(good, signature))
        await intruder.rejected("ENCODING_INVALID", _with_signature(good, good.signature[:64]))
        await intruder.rejected("SENDER_NOT_ADMITTED", _with_signature(good, _high_s(good.signature)))


async def test_a_bad_copy_keeps_neither_the_good_one_nor_its_batch_out(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    """A stranger who saw the body first and sends it with a wrong signature gains nothing."""
    good = network.transaction()
    await intruder.rejected("SENDER_NOT_ADMITTED", _with_signature(good, network.transaction().signature))
    await network.finalize(intruder.node, good)
    good = network.transaction()
    results = await intruder.submit(b"garbage", good.wire, good.wire[:-1])
    assert [one["status"] for one in results] == ["rejected", "accepted", "rejected"]
    await intruder.final(good)


async def test_a_replay_is_executed_once(network: NetworkUnderTest, intruder: Intruder) -> None:
    """Sent again while it waits, it is the same transaction; sent again when it is final, it is refused everywhere."""
    transaction = network.transaction()
    answers = await asyncio.gather(*(intruder.submit(transaction.wire, transaction.wire) for _ in range(8)))
    outcomes = [one for answer in answers for one in answer]
    assert {one["txid"] for one in outcomes} == {transaction.txid.hex()}
    assert {one["error"]["code"] for one in outcomes if one["error"]} <= {"TRANSACTION_REPLAYED"}
    await intruder.final(transaction)
    async with nothing_changes(network):
        for name in network.names:
            await intruder.rejected("TRANSACTION_REPLAYED", transaction.wire, node=name)


async def test_a_stranger_has_no_transaction_waiting(network: NetworkUnderTest, intruder: Intruder) -> None:
    stranger = new_key()
    async with nothing_changes(network):
        for contract, entry in (
            ("records", "open_visit"),
            ("access", "request"),
            ("identity", "leave"),
            ("no", "such"),
        ):
            await intruder.rejected("SENDER_NOT_ADMITTED", intruder.call(stranger, contract, entry, b"").wire)


async def test_calls_that_no_version_takes_are_refused_at_the_door(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    member = (await intruder.enrol()).identity
    nested: object = b""
    for _ in range(14):
        nested = [nested]
    calls = [
        intruder.call(member, "identity", "nothing"),
        intruder.call(member, "identity", "genesis", [], [], []),
        intruder.call(member, "identity", "member", b""),
        intruder.call(member, "identity", "register"),
        intruder.call(member, "identity", "leave", nested),
        intruder.call(member, "identity", "leave", 1 << 255),
        intruder.call(member, "identity", "check_keys", b"", b"", b""),
        intruder.call(member, "identity", "__init__"),
    ]
    async with nothing_changes(network):
        for call in calls:
            await intruder.rejected("CONTRACT_CALL_OUTDATED", call.wire)


async def test_a_call_of_a_contract_that_is_not_there_leaves_only_a_receipt(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    """It is taken: the contract may be there by the time of the block."""
    member = (await intruder.enrol()).identity
    async with nothing_changes(network):
        receipt = await intruder.final(intruder.call(member, "nothing", "here"))
        assert not receipt["ok"]
        assert receipt["code"].isupper()
        assert "Traceback" not in receipt["message"]


async def test_arguments_nested_without_end_are_refused(network: NetworkUnderTest, intruder: Intruder) -> None:
    good = network.transaction()
    async with nothing_changes(network):
        for depth in (17, 1000, 15_000):
            arguments = b"\x91" * depth + b"\xc0"
            body = msgspec.structs.replace(good.body, args=arguments)
            wire = encode(TransactionWire(body=encode(body), signature=good.signature))
            (result,) = await intruder.submit(wire)
            assert result["error"]["code"] in {"ENCODING_INVALID", "VALUE_INVALID"}


# Enrolment


async def test_a_code_registers_once_and_a_taken_handle_is_not_given_out_twice(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    card = intruder.card()
    assert (await intruder.final(intruder.registration(card, new_member())))["ok"]
    async with nothing_changes(network):
        await intruder.rejected("HANDLE_TAKEN", intruder.registration(card, new_member()).wire)
    # Even a registrar cannot issue a second card for a handle that is registered.
    again = intruder.card(handle=card.handle)
    async with nothing_changes(network):
        await intruder.rejected("HANDLE_TAKEN", intruder.registration(again, new_member()).wire)


async def test_two_who_use_one_code_at_once_do_not_both_get_in(network: NetworkUnderTest, intruder: Intruder) -> None:
    card, first, second = intruder.card(), new_member(), new_member()
    calls = [intruder.registration(card, member) for member in (first, second)]
    await asyncio.gather(
        *(intruder.submit(call.wire, node=name) for call, name in zip(calls, network.names[:2], strict=True))
    )
    places = [await network.place(intruder.node, call.txid, 3_000) for call in calls]
    receipts = [place["receipt"] for place in places if place["status"] == "finalized"]
    assert sum(receipt["ok"] for receipt in receipts) == 1
    assert {receipt["code"] for receipt in receipts} <= {"OK", "HANDLE_TAKEN"}


async def test_a_foreign_or_expired_code_registers_nobody_nor_a_patients_a_robot(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    cards = [intruder.card(registrar=new_key()), intruder.card(chain_id=secrets.token_bytes(32))]
    async with nothing_changes(network):
        for card in cards:
            await intruder.rejected("VOUCHER_FOREIGN", intruder.registration(card, new_member()).wire)
    await intruder.final(network.transaction())
    card = intruder.card(not_after_ms=now_ms() - 60_000)
    async with nothing_changes(network):
        await intruder.rejected("VOUCHER_EXPIRED", intruder.registration(card, new_member()).wire)
    member = new_member()
    arguments = intruder.registration(intruder.card(), member).arguments()
    arguments[2] = "robot"
    call = intruder.call(member.identity, "identity", "register", *arguments)
    async with nothing_changes(network):
        await intruder.rejected("VOUCHER_FOREIGN", call.wire)


async def test_a_voucher_seen_in_the_mempool_is_worth_nothing_to_who_saw_it(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    """The thief copies the fields of a registration that waits, and is even the first to reach another node."""
    victim, thief, card = new_member(), new_member(), intruder.card()
    waiting = intruder.registration(card, victim)
    seen = waiting.arguments()
    own_keys = [*seen[:5], thief.spend, thief.view, thief.sealing, *seen[8:]]
    own_signature = [*own_keys[:8], thief.identity.sign("blockrobot/card", b"anything"), own_keys[9]]
    for arguments in (seen, own_keys, own_signature):
        call = intruder.call(thief.identity, "identity", "register", *arguments)
        await intruder.rejected("VOUCHER_FOREIGN", call.wire, node=network.names[1])
    assert (await intruder.submit(waiting.wire))[0]["status"] == "accepted"
    call = intruder.call(thief.identity, "identity", "register", *own_keys)
    (result,) = await intruder.submit(call.wire, node=network.names[2])
    assert result["status"] == "rejected"
    assert (await intruder.final(waiting))["ok"]
    session = await intruder.session(victim.identity)
    assert session


# Sessions


async def test_without_a_session_of_this_node_nothing_is_read(intruder: Intruder, network: NetworkUnderTest) -> None:
    for path in ("/v1/finality", "/v1/headers?from_height=0&limit=1", "/v1/announcements", "/v1/blocks/0"):
        await intruder.refused("SESSION_REQUIRED", "GET", path)
    await intruder.refused("SESSION_REQUIRED", "POST", "/v1/queries", json={})
    token = await intruder.session(network.registrar, network.names[1])
    assert (await intruder.ask("GET", "/v1/finality", headers=token, node=network.names[1]))[0] == 200
    await intruder.refused("SESSION_EXPIRED", "GET", "/v1/finality", headers=token)


@pytest.mark.parametrize(
    "header", ["Bearer " + "00" * 32, "Bearer", "Basic dXNlcjpwYXNz", "Bearer " + "zz" * 32, "Bearer " + "a" * 5000, ""]
)
async def test_a_token_that_is_none_opens_nothing(intruder: Intruder, header: str) -> None:
    await intruder.refused("SESSION_EXPIRED", "GET", "/v1/finality", headers={"Authorization": header})


async def test_a_session_is_for_no_stranger_and_does_no_others_work(intruder: Intruder) -> None:
    stranger = new_key()
    answer = intruder.answer_to(stranger, await intruder.challenge(stranger))
    await intruder.refused("SESSION_REFUSED", "POST", "/v1/sessions", json=answer)
    token = await intruder.session((await intruder.enrol()).identity)
    await intruder.refused("NOT_PERMITTED", "PUT", "/v1/clips/" + "00" * 16, data=b"", headers=token)
    await intruder.refused("NOT_PERMITTED", "GET", f"/v1/clips/{'00' * 16}?access_id={'00' * 32}", headers=token)


async def test_a_challenge_answers_one_key_at_one_node_once(network: NetworkUnderTest, intruder: Intruder) -> None:
    registrar, other = network.registrar, (await intruder.enrol()).identity
    used = intruder.answer_to(registrar, await intruder.challenge(registrar))
    assert (await intruder.ask("POST", "/v1/sessions", json=used))[0] == 200
    await intruder.refused("CHALLENGE_INVALID", "POST", "/v1/sessions", json=used)

    for_other = intruder.answer_to(other, await intruder.challenge(registrar))
    await intruder.refused("CHALLENGE_INVALID", "POST", "/v1/sessions", json=for_other)

    elsewhere = network.names[1]
    foreign = intruder.answer_to(registrar, await intruder.challenge(registrar, elsewhere), elsewhere)
    await intruder.refused("CHALLENGE_INVALID", "POST", "/v1/sessions", json=foreign)


async def test_a_node_cannot_pass_anothers_challenge_on(network: NetworkUnderTest, intruder: Intruder) -> None:
    """A dishonest node gets a member to sign another node's challenge; the signature names the dishonest one."""
    challenge = await intruder.challenge(network.registrar)
    relayed = intruder.answer_to(network.registrar, challenge, node=network.names[1])
    await intruder.refused("SIGNATURE_INVALID", "POST", "/v1/sessions", json=relayed)


# HTTP


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/v1/session-challenges", b""),
        ("/v1/session-challenges", b"{"),
        ("/v1/session-challenges", b"\xff\xfe"),
        ("/v1/session-challenges", b"[" * 1000),
        ("/v1/session-challenges", b'{"public_key":' * 70),
        ("/v1/session-challenges", b'{"public_key": 7}'),
        ("/v1/session-challenges", b'{"public_key": "' + b"02" * 33 + b'", "more": 1}'),
        ("/v1/transactions", b""),
        ("/v1/transactions", b"\x90"),
        ("/v1/transactions", b"\x91\x01"),
        ("/v1/transactions", b"\xdd\xff\xff\xff\xff"),
        ("/v1/transactions", b"\x91" * 60_000),
    ],
)
async def test_bodies_of_another_form_are_refused(intruder: Intruder, path: str, body: bytes) -> None:
    media_type = MSGPACK if path.endswith("transactions") else "application/json"
    await intruder.refused("REQUEST_INVALID", "POST", path, data=body, headers={"Content-Type": media_type})


async def test_bodies_that_are_large_or_packed_are_refused(intruder: Intruder) -> None:
    for path, size in (("/v1/session-challenges", 2000), ("/v1/transactions", 3 * 1024 * 1024)):
        await intruder.refused("REQUEST_TOO_LARGE", "POST", path, data=io.BytesIO(bytes(size)))
    bomb = gzip.compress(bytes(64 * 1024 * 1024))
    headers = {"Content-Encoding": "gzip", "Content-Type": MSGPACK}
    await intruder.refused("MEDIA_TYPE_UNSUPPORTED", "POST", "/v1/transactions", data=bomb, headers=headers)
    for encoding in ("gzip", "deflate", "br", "nonsense"):
        headers = {"Content-Encoding": encoding, "Content-Type": "application/json"}
        path = "/v1/session-challenges"
        await intruder.refused("MEDIA_TYPE_UNSUPPORTED", "POST", path, data=b"packed", headers=headers)


async def test_a_body_of_another_media_type_is_refused(intruder: Intruder) -> None:
    """Such a request is what a web page can make a browser send without asking."""
    for media_type in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        for path in ("/v1/transactions", "/v1/session-challenges", "/v1/sessions"):
            await intruder.refused(
                "MEDIA_TYPE_UNSUPPORTED", "POST", path, data=b"{}", headers={"Content-Type": media_type}
            )


async def test_unknown_routes_and_methods_are_refused(intruder: Intruder) -> None:
    for path in (
        "/",
        "/v1",
        "/v1/",
        "/v2/genesis",
        "/metrics",
        "/status",
        "/v1/../node.toml",
        "/v1/%2e%2e/keys",
        "/%00",
    ):
        await intruder.refused("ROUTE_UNKNOWN", "GET", path)
    for method in ("DELETE", "PUT", "PATCH", "OPTIONS", "TRACE", "PROPFIND"):
        await intruder.refused("METHOD_NOT_ALLOWED", method, "/v1/genesis")


@pytest.mark.parametrize(
    "path", ["/v1/transactions/xyz", "/v1/transactions/" + "00" * 33, "/v1/transactions/" + "AA" * 32]
)
async def test_ids_of_another_form_are_refused(intruder: Intruder, path: str) -> None:
    await intruder.refused("REQUEST_INVALID", "GET", path)


@pytest.mark.parametrize("wait", ["-1", "1e9", "99999999", "٣", "", "0x10"])
async def test_numbers_of_another_form_are_refused(intruder: Intruder, wait: str) -> None:
    await intruder.refused("REQUEST_INVALID", "GET", f"/v1/transactions/{'00' * 32}?wait_ms={wait}")


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"GET /v1/genesis HTTP/1.1\r\nHost: x\r\nX-Huge: " + b"a" * 200_000 + b"\r\n\r\n",
        b"GET /" + b"a" * 200_000 + b" HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET /v1/genesis HTTP/1.1\r\n" + b"".join(b"X-%d: a\r\n" % number for number in range(40_000)) + b"\r\n",
        b"nonsense\r\n\r\n",
        b"GET /v1/genesis HTTP/9.9\r\n\r\n",
        b"POST /v1/transactions HTTP/1.1\r\nHost: x\r\nContent-Length: -5\r\n\r\n",
        b"POST /v1/transactions HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
        b"POST /v1/transactions HTTP/1.1\r\nHost: x\r\nContent-Type: application/msgpack\r\n"
        b"Transfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"GET /v1/genesis HTTP/1.1\r\nHost: x\r\nExpect: the-impossible\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(64) + b"\r\n\r\n",
    ],
)
async def test_what_is_not_http_as_the_node_speaks_it_is_refused_plainly(
    intruder: Intruder, request_bytes: bytes
) -> None:
    answer = await intruder.raw(request_bytes)
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head[:10] in {b"HTTP/1.0 4", b"HTTP/1.1 4"}, answer[:300]
    assert b"application/problem+json" in head, answer[:300]
    problem = msgspec.json.decode(body)
    assert problem["code"] in {"REQUEST_INVALID", "REQUEST_TOO_LARGE"}
    assert problem["next_step"]
    assert b"Traceback" not in answer
    assert b"aiohttp" not in answer.lower()


async def test_the_network_is_well_after_all_that(network: NetworkUnderTest, intruder: Intruder) -> None:
    await intruder.final(network.transaction())
    for config in network.cluster.configs.values():
        log = config.log_path.read_text(encoding="utf-8")
        assert "unexpected fault" not in log
        assert "Traceback" not in log
