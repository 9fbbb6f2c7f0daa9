"""Transactions of simulated clients, signed once per process and reused.

Calls of a batch run together; the next batch follows once all are final.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgspec

from consensus.chain.transaction import Transaction, sign_transaction
from consensus.limits import SEALED_METADATA_BYTES
from consensus.members.vouchers import issue_card, sign_card
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from consensus.records.commitments import ciphertext_leaves, ciphertext_root, commitment_root, derive_record_id
from consensus.records.envelopes import SEALED_KEY_BYTES
from network.sim.plan import GROWTH_SEATS_COUNT, NetworkSize
from network.sim.world.sim_chain import EPOCH_MS, Chain, make_chain, make_key, make_node_entry, node_name

VALID_UNTIL_MS = EPOCH_MS + 9 * 60_000
KEPT_LONG_MS = EPOCH_MS + 24 * 3600 * 1000
RECORDS_A_VISIT = 3
FRAMES_COUNT = 2
COPIES_COUNT = 2
"""Of a clip, in the profile `custody`."""
CUSTODY_TURNOVERS_COUNT = 4
"""Kinds of turnover; a seed plays one of them."""
PURPOSE = "demo"
EXPIRED = "EXPIRY_WRONG"
TOO_LATE = ("RECORD_UNKNOWN", "RECORD_ERASED")


@dataclass(frozen=True)
class Call:
    """A transaction and the clip that goes to the custodians with it.

    It waits until `seats` producers are seated, `after_repair` until every keeper has its clips; when it begins, node
    `dying` is lost for good. `excused` error codes are no failure.
    """

    transaction: Transaction
    upload: ClipUpload | None = None
    seats: int = 0
    excused: tuple[str, ...] = ()
    after_repair: bool = False
    dying: int = -1


def make_material(size: int, *parts: Any) -> bytes:
    """Bytes that look random and are always the same for the same parts."""
    seed = " ".join(map(str, parts)).encode()
    return b"".join(sha256(seed + bytes([number])) for number in range(-(-size // 32)))[:size]


def sign_call(
    chain: Chain, key: PrivateKey, contract: str, entry: str, arguments: list[Any], *salt: Any
) -> Transaction:
    """Return a signed call; its salt is derived from the call and `salt`."""
    return sign_transaction(
        key,
        chain_id=chain.genesis.chain_id,
        contract=contract,
        entry=entry,
        arguments=arguments,
        valid_until_ms=VALID_UNTIL_MS,
        salt=make_material(8, contract, entry, *salt),
    )


@cache
def enrolment(size: NetworkSize, client: int) -> Call:
    chain, robot = make_chain(size), make_key(f"robot {client}")
    card = issue_card(
        chain.registrar,
        chain_id=chain.genesis.chain_id,
        handle=make_material(32, "handle", client),
        card_secret=make_material(32, "card", client),
        role="robot",
        not_after_ms=KEPT_LONG_MS,
    )
    keys = {"member": robot.public_key, "spend": robot.public_key, "view": robot.public_key}
    sealing = make_material(32, "sealing", client)
    signature = sign_card(card, chain_id=chain.genesis.chain_id, sealing=sealing, **keys)
    arguments = [card.handle, card.card_public, card.role, card.not_after_ms, card.voucher_signature]
    arguments += [robot.public_key, robot.public_key, sealing, signature, [PURPOSE]]
    return Call(sign_call(chain, robot, "identity", "register", arguments, client))


@cache
def visit(size: NetworkSize, client: int, number: int) -> tuple[tuple[Call, ...], ...]:
    chain, robot = make_chain(size), make_key(f"robot {client}")
    owner = make_key(f"owner {client} {number}")
    clips = [_record(chain, robot, owner, client, number, index) for index in range(RECORDS_A_VISIT)]
    ids = [upload.record_id for _, upload in ((call.transaction, call.upload) for call in clips) if upload]
    opened = [owner.public_key, owner.public_key, number % 256, EPOCH_MS, PURPOSE]
    salt = (client, number)
    asked, excused = (ids[1:], TOO_LATE) if number % 2 else ([], ())
    erased, frames = (ids[:1], [1]) if number % 3 == 2 else (ids[: 1 + number % 2], [])
    return (
        (Call(sign_call(chain, robot, "records", "open_visit", opened, *salt)),),
        tuple(clips),
        (Call(sign_call(chain, owner, "access", "request", [asked, PURPOSE], *salt), excused=excused),),
        (Call(sign_call(chain, owner, "erasure", "request", [erased, frames], *salt)),),
        (Call(sign_call(chain, robot, "records", "close_visit", [owner.public_key, len(ids)], *salt)),),
    )


@cache
def setting_change(size: NetworkSize, number: int) -> tuple[tuple[Call, ...], ...]:
    return tuple(_decide(make_chain(size), "settings", [["heartbeat_ms", 20_000 + number]], number))


@cache
def producer_turnover(size: NetworkSize, number: int) -> tuple[tuple[Call, ...], ...]:
    """The last node loses and regains its seat."""
    chain, index = make_chain(size), size.nodes - 1
    key = chain.producers[index].public_key
    own = chain.admins[index % len(chain.admins)]
    return (
        (Call(sign_call(chain, own, "producers", "remove", [key], number)),),
        (Call(sign_call(chain, chain.admins[0], "producers", "propose", [key], number)),),
        (Call(sign_call(chain, chain.admins[-1], "producers", "approve", [key], number)),),
    )


@cache
def growth(size: NetworkSize, number: int) -> tuple[tuple[Call, ...], ...]:
    """Followers become members, are seated, and all are unseated."""
    chain = make_chain(size)
    admins = (chain.admins[0], chain.admins[-1])
    batches: list[tuple[Call, ...]] = []
    for seats, goal in itertools.pairwise(GROWTH_SEATS_COUNT):
        newcomers = chain.producers[seats:goal]
        if number == 0:
            batches += _join(chain, range(seats, goal))
        for admin, entry in zip(admins, ("propose", "approve"), strict=True):
            votes = [sign_call(chain, admin, "producers", entry, [key.public_key], number, goal) for key in newcomers]
            batches.append(tuple(Call(vote, seats=seats) for vote in votes))
    smallest, largest = GROWTH_SEATS_COUNT[0], GROWTH_SEATS_COUNT[-1]
    removals = [
        sign_call(chain, admins[index % 2], "producers", "remove", [chain.producers[index].public_key], number)
        for index in range(smallest, largest)
    ]
    batches.append(tuple(Call(removal, seats=largest) for removal in removals))
    return tuple(batches)


@cache
def custody_turnover(size: NetworkSize, number: int) -> tuple[tuple[Call, ...], ...]:
    """Five custodians become six; of those that only keep one leaves and one dies, in either order; one more comes.

    Each time the others have to fetch what they are to keep now, and whoever goes next waits for that. Afterwards the
    number of copies changes to and fro.
    """
    chain, (first, second, last) = make_chain(size), range(size.producers, size.nodes)
    if number >= CUSTODY_TURNOVERS_COUNT:
        copies = ["custody_copies", COPIES_COUNT + (number - CUSTODY_TURNOVERS_COUNT + 1) % 2]
        return tuple(_decide(chain, "settings", [copies], number, after_repair=True))
    leaving, dying = (first, second) if number % 2 else (second, first)
    gone = [{"name": node_name(index)} for index in (leaving, dying)]
    left = _decide(chain, "membership", [["remove_node", gone[0]]], number, after_repair=True)
    died = _decide(chain, "membership", [["remove_node", gone[1]]], number, after_repair=True, dying=dying)
    return (
        *_decide(chain, "settings", [["custody_copies", COPIES_COUNT]], number),
        *_join(chain, range(second, second + 1), after_repair=True),
        *(left + died if number // 2 % 2 else died + left),
        *_join(chain, range(last, last + 1), after_repair=True),
    )


def _join(chain: Chain, newcomers: range, *, after_repair: bool = False) -> list[tuple[Call, ...]]:
    keeps = after_repair
    keys = [(None, chain.custodians[index]) if keeps else (chain.producers[index], None) for index in newcomers]
    entries = [
        msgspec.structs.asdict(make_node_entry(index, *pair)) for index, pair in zip(newcomers, keys, strict=True)
    ]
    return _decide(chain, "membership", [["add_node", entry] for entry in entries], after_repair=after_repair)


def _decide(
    chain: Chain, contract: str, proposed: Sequence[list[Any]], *salt: Any, after_repair: bool = False, dying: int = -1
) -> list[tuple[Call, ...]]:
    proposals = [sign_call(chain, chain.admins[0], contract, "propose", what, *salt) for what in proposed]
    approvals = [sign_call(chain, chain.admins[-1], contract, "approve", [each.txid], *salt) for each in proposals]
    return [
        tuple(Call(each, after_repair=after_repair, dying=dying) for each in proposals),
        tuple(map(Call, approvals)),
    ]


def _record(chain: Chain, robot: PrivateKey, owner: PrivateKey, client: int, number: int, index: int) -> Call:
    place = (client, number, index)
    texts = [make_material(64, "text", *place, frame) for frame in range(FRAMES_COUNT)]
    keys = [make_material(SEALED_KEY_BYTES, "key", *place, frame) for frame in range(FRAMES_COUNT)]
    leaves = [make_material(32, "leaf", *place, frame) for frame in range(FRAMES_COUNT)]
    root = commitment_root(leaves)
    record_id = derive_record_id(owner.public_key, root)
    expires_at_ms = EPOCH_MS + 2_000 + 700 * number if index == RECORDS_A_VISIT - 1 else KEPT_LONG_MS
    arguments = [
        record_id,
        owner.public_key,
        root,
        ciphertext_root(ciphertext_leaves(texts, keys)),
        make_material(SEALED_METADATA_BYTES, "metadata", *place),
        EPOCH_MS,
        expires_at_ms,
    ]
    transaction = sign_call(chain, robot, "records", "record", arguments, *place)
    upload = ClipUpload(
        record_id=record_id,
        txid=transaction.txid,
        valid_until_ms=VALID_UNTIL_MS,
        ciphertexts=texts,
        sealed_keys=keys,
        commitment_leaves=leaves,
        owner=owner.public_key,
    )
    return Call(transaction, upload, excused=(EXPIRED,) if index == RECORDS_A_VISIT - 1 else ())
