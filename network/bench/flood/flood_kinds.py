"""Endless attacker messages by kind, resembling the protocol.

Every node frame, request and route with a body has a flood here; others are in `flood_routes`. Signatures are false
unless stated.
"""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import msgspec

from consensus.chain.block import Block, IndexedSignature, QuorumCertificate
from consensus.chain.messages import CertificateNotice, LastSignedRequest, LastSignedResponse, Proposal, Timeout, Vote
from consensus.chain.transaction import TransactionBody, TransactionWire, sign_transaction
from consensus.primitives.encoding import encode, encode_value
from consensus.primitives.keys import PrivateKey
from consensus.state import identity
from node.p2p.wire import (
    FRAME_MAX_BYTES,
    BranchRequest,
    ClipRequest,
    FinalizedRequest,
    FrameKind,
    HeightNotice,
    RequestKind,
    SnapshotRequest,
    TransactionBatch,
    encode_frame,
    encode_request,
)

Identity = Literal["stranger", "member", "robot", "node"]
POOL_COUNT = 64
BATCH_COUNT = 256
_LIFETIME_MS = 5 * 60 * 1000


@dataclass(frozen=True, slots=True)
class Target:
    """The attacker's knowledge: chain, a member's key and progress, its own key and name."""

    chain_id: bytes
    member: bytes
    epoch: int
    round: int
    head_id: bytes
    name: str
    key: PrivateKey


def false_signature(size: int = 65) -> bytes:
    return (secrets.token_bytes(32) + b"\x3f" + secrets.token_bytes(31) + b"\x00" * 8)[: size - 1] + b"\x01"


def _wire(target: Target, sender: bytes, contract: str, entry: str, arguments: list[object]) -> bytes:
    body = TransactionBody(
        version=1,
        chain_id=target.chain_id,
        sender=sender,
        contract=contract,
        entry=entry,
        args=encode_value(arguments),
        valid_until_ms=time.time_ns() // 1_000_000 + _LIFETIME_MS,
        salt=secrets.token_bytes(8),
    )
    return encode(TransactionWire(body=encode(body), signature=false_signature()))


def by_strangers(target: Target) -> bytes:
    sender = PrivateKey(secrets.token_bytes(32)).public_key
    return _wire(target, sender, "records", "record", [secrets.token_bytes(32)])


def in_a_members_name(target: Target) -> bytes:
    return _wire(target, target.member, "consent", "object", [secrets.token_bytes(32)])


def registration(target: Target) -> bytes:
    sender = PrivateKey(secrets.token_bytes(32)).public_key
    late_ms = time.time_ns() // 1_000_000 + _LIFETIME_MS
    arguments: list[object] = [
        secrets.token_bytes(32),
        target.member,
        "subject",
        late_ms,
        false_signature(),
        target.member,
        target.member,
        secrets.token_bytes(32),
        false_signature(),
        [],
    ]
    return _wire(target, sender, "identity", "register", arguments)


def signed(target: Target) -> bytes:
    return sign_transaction(
        target.key,
        chain_id=target.chain_id,
        contract="consent",
        entry="object",
        arguments=[secrets.token_bytes(32)],
        valid_until_ms=time.time_ns() // 1_000_000 + _LIFETIME_MS,
        salt=secrets.token_bytes(8),
    ).wire


def _qc(target: Target, round_number: int) -> QuorumCertificate:
    votes = tuple(IndexedSignature(index=index, signature=false_signature(64)) for index in range(3))
    return QuorumCertificate(epoch=target.epoch, round=round_number, block_id=secrets.token_bytes(32), votes=votes)


def _near(target: Target) -> int:
    return target.round + 1 + secrets.randbelow(32)


def _vote(target: Target) -> bytes:
    vote = Vote(
        epoch=target.epoch,
        round=_near(target),
        block_id=secrets.token_bytes(32),
        index=secrets.randbelow(4),
        signature=false_signature(64),
    )
    return encode_frame(FrameKind.VOTE, encode(vote))


def _timeout(target: Target) -> bytes:
    number = _near(target)
    timeout = Timeout(
        epoch=target.epoch,
        round=number,
        qc=_qc(target, number - 1),
        entered_by=None,
        index=secrets.randbelow(4),
        signature=false_signature(64),
    )
    return encode_frame(FrameKind.TIMEOUT, encode(timeout))


def _proposal(_target: Target) -> bytes:
    block = Block(
        header_bytes=secrets.token_bytes(400),
        signature=false_signature(64),
        transactions=tuple(secrets.token_bytes(300) for _ in range(64)),
    )
    return encode_frame(FrameKind.PROPOSAL, encode(Proposal(block=block)))


def _notice(target: Target) -> bytes:
    return encode_frame(FrameKind.NOTICE, encode(CertificateNotice(qc=_qc(target, _near(target)), entered_by=None)))


def _last_signed_answer(target: Target) -> bytes:
    answer = LastSignedResponse(
        epoch=target.epoch,
        asked_at_ms=time.time_ns() // 1_000_000,
        signing_state="signing",
        signed_round=_near(target),
        message=None,
        qc=_qc(target, _near(target)),
        entered_by=None,
    )
    return encode_frame(FrameKind.LAST_SIGNED_RESPONSE, encode(answer))


def _last_signed_request(target: Target) -> bytes:
    request = LastSignedRequest(epoch=target.epoch, asked_at_ms=time.time_ns() // 1_000_000)
    return encode_frame(FrameKind.LAST_SIGNED_REQUEST, encode(request))


def _height(target: Target) -> bytes:
    notice = HeightNotice(finalized_height=secrets.randbelow(1 << 40), epoch=target.epoch + secrets.randbelow(2))
    return encode_frame(FrameKind.HEIGHT, encode(notice))


def _epoch(_target: Target) -> bytes:
    return encode_frame(FrameKind.EPOCH, secrets.token_bytes(4_000))


def _batch(make: Callable[[Target], bytes]) -> Callable[[Target], bytes]:
    def batch(target: Target) -> bytes:
        wires = tuple(make(target) for _ in range(BATCH_COUNT))
        return encode_frame(FrameKind.TRANSACTIONS, encode(TransactionBatch(transactions=wires)))

    return batch


def _request(kind: RequestKind, body: Callable[[Target], bytes]) -> Callable[[Target], bytes]:
    def request(target: Target) -> bytes:
        return encode_frame(FrameKind.REQUEST, encode_request(secrets.randbits(32), kind, body(target)))

    return request


def _raw(kind: int, size: int) -> Callable[[Target], bytes]:
    def raw(_target: Target) -> bytes:
        return (size + 1).to_bytes(4, "big") + bytes([kind]) + secrets.token_bytes(size)

    return raw


FRAMES: dict[str, Callable[[Target], bytes]] = {
    "HELLO": _raw(FrameKind.HELLO, 100),
    "REFUSAL": _raw(FrameKind.REFUSAL, 50),
    "PROPOSAL": _proposal,
    "VOTE": _vote,
    "TIMEOUT": _timeout,
    "NOTICE": _notice,
    "EPOCH": _epoch,
    "HEIGHT": _height,
    "LAST_SIGNED_REQUEST": _last_signed_request,
    "LAST_SIGNED_RESPONSE": _last_signed_answer,
    "RESPONSE": _raw(FrameKind.RESPONSE, FRAME_MAX_BYTES[FrameKind.RESPONSE] // 8),
    "TRANSACTIONS": _batch(in_a_members_name),
    "TRANSACTIONS:strangers": _batch(by_strangers),
    "TRANSACTIONS:registrations": _batch(registration),
    "TRANSACTIONS:signed": _batch(signed),
    "REQUEST:BRANCH": _request(
        RequestKind.BRANCH, lambda target: encode(BranchRequest(block_id=target.head_id, above_height=0))
    ),
    "REQUEST:FINALIZED": _request(
        RequestKind.FINALIZED, lambda _target: encode(FinalizedRequest(from_height=secrets.randbelow(64), count=256))
    ),
    "REQUEST:SNAPSHOT": _request(
        RequestKind.SNAPSHOT, lambda _target: encode(SnapshotRequest(content_id=b"", index=-1, above_height=0))
    ),
    "REQUEST:CLIP": _request(
        RequestKind.CLIP, lambda _target: encode(ClipRequest(record_id=secrets.token_bytes(32), offset=0))
    ),
    "REQUEST:BACKGROUND": _request(RequestKind.BACKGROUND, lambda _target: secrets.token_bytes(32)),
    "garbage": _raw(99, 2_000),
    "oversized": _raw(FrameKind.VOTE, 60_000),
}
"""By a node's certificate. A name before the colon is a frame's, behind it a variant's or a request's."""


@dataclass(frozen=True, slots=True)
class HttpFlood:
    """Requests of one route; `drips` sends slowly, `streams` are read partly, then closed."""

    method: str
    path: str
    media_type: str
    body: Callable[[Target], bytes]
    drips: bool = False
    headers: str = ""
    streams: bool = False


def _wires(make: Callable[[Target], bytes]) -> Callable[[Target], bytes]:
    return lambda target: msgspec.msgpack.encode([make(target) for _ in range(BATCH_COUNT)])


def _json(make: Callable[[Target], object]) -> Callable[[Target], bytes]:
    return lambda target: json.dumps(make(target)).encode()


_PACKED, _JSON, _BYTES = "application/msgpack", "application/json", "application/octet-stream"
_SUBMIT = "/v1/transactions"
_GRANT = "/v1/grants/" + "00" * 32 + "/" + "00" * 32

ROUTES: dict[str, HttpFlood] = {
    "submitTransactions": HttpFlood("POST", _SUBMIT, _PACKED, _wires(in_a_members_name)),
    "submitTransactions:strangers": HttpFlood("POST", _SUBMIT, _PACKED, _wires(by_strangers)),
    "submitTransactions:registrations": HttpFlood("POST", _SUBMIT, _PACKED, _wires(registration)),
    "submitTransactions:signed": HttpFlood("POST", _SUBMIT, _PACKED, _wires(signed)),
    "submitTransactions:garbage": HttpFlood("POST", _SUBMIT, _PACKED, lambda _target: secrets.token_bytes(100_000)),
    "submitTransactions:oversized": HttpFlood("POST", _SUBMIT, _PACKED, lambda _target: bytes(2 * 1024 * 1024)),
    "submitTransactions:slow": HttpFlood("POST", _SUBMIT, _PACKED, _wires(by_strangers), drips=True),
    "createSessionChallenge": HttpFlood(
        "POST", "/v1/session-challenges", _JSON, _json(lambda target: {"public_key": target.member.hex()})
    ),
    "createSession": HttpFlood(
        "POST",
        "/v1/sessions",
        _JSON,
        _json(
            lambda target: {
                "public_key": target.member.hex(),
                "challenge": secrets.token_hex(32),
                "signature": false_signature().hex(),
            }
        ),
    ),
    "deleteSession": HttpFlood("DELETE", "/v1/sessions", _JSON, lambda _target: b""),
    "proveState": HttpFlood(
        "POST",
        "/v1/state-proofs",
        _JSON,
        _json(lambda _target: {"keys": [identity.MEMBER.key(secrets.token_bytes(33)).hex() for _ in range(64)]}),
    ),
    "proveNotices": HttpFlood(
        "POST",
        "/v1/notice-proofs",
        _JSON,
        _json(lambda target: {"keys": [identity.REGISTRAR.key(target.member).hex()] * 8}),
    ),
    "queryContract": HttpFlood(
        "POST",
        "/v1/queries",
        _JSON,
        _json(
            lambda target: {
                "contract": "identity",
                "view": "role_of",
                "args": encode_value([target.member]).hex(),
            }
        ),
    ),
    "signConsentReceipt": HttpFlood(
        "POST", "/v1/consent-receipts", _JSON, _json(lambda _target: {"txid": secrets.token_hex(32)})
    ),
    "downloadSharedClip": HttpFlood("POST", _GRANT, _PACKED, lambda _target: secrets.token_bytes(1_000)),
    "uploadKeyPart": HttpFlood("PUT", _GRANT, _PACKED, lambda _target: secrets.token_bytes(2_000)),
    "uploadClip": HttpFlood(
        "PUT", f"/v1/clips/{'00' * 16}?owner={'00' * 33}", _PACKED, lambda _target: secrets.token_bytes(500_000)
    ),
    "putBackground": HttpFlood(
        "PUT", "/v1/backgrounds/" + "00" * 32, _BYTES, lambda _target: secrets.token_bytes(500_000)
    ),
}
"""By a client, with a session or without one. A name before the colon is a route's operation."""

HANDSHAKES = "handshakes"
"""TLS connections to the nodes' own ports, by whoever has no certificate."""


def pool_of(make: Callable[[Target], bytes], target: Target, count: int = POOL_COUNT) -> Iterator[bytes]:
    """Yield `count` different messages in an endless cycle."""
    made = []
    for _ in range(count):
        made.append(make(target))
        yield made[-1]
    while True:
        yield from made
