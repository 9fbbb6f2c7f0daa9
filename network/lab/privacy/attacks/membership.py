"""Attacks on membership: who is enrolled, who was present today."""

from __future__ import annotations

import secrets
from collections import defaultdict
from collections.abc import Collection

import msgspec
import numpy as np

from consensus.chain.transaction import TransactionBody, TransactionWire
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import MEMBER
from network.lab.privacy.attacks.dictionary import weak_functions
from network.lab.privacy.attacks.ledger_view import LedgerView
from network.lab.privacy.hospital.attacked_chain import Chain
from network.lab.privacy.hospital.attacked_days import Played, day_of
from network.lab.privacy.hospital.schemes import OwnerMark, Scheme, hash_uid
from network.lab.privacy.scoring import Rate, choice_score, grouped_rate
from node.api.access.sessions import SessionTable
from node.mempool.mempool import Mempool
from node.mempool.transaction_cache import TransactionCache
from node.mempool.transaction_intake import redact_for_clients

SPEAKING_ENTRIES = ("give", "refuse", "withdraw", "object_to")
"""What people call themselves to say something of their consent. All else under a handle is a leak."""

PROBES_COUNT = 400
"""How many: of ties alone fewer than 300 do not show that the answers are the same."""

_TRIALS_A_PERSON_COUNT = 8


def attack_enrolment(played: Played, marks: Collection[bytes], scheme: Scheme | None, *, seed: int) -> Rate:
    """Guess the enrolled one of two admitted people by UID; `scheme` None: ours, with all `marks`."""
    population = played.population
    enrolled = [person.uid for person in population.people if person.enrolled]
    strangers = [person.uid for person in population.people if not person.enrolled]
    if scheme is None:
        functions, known = weak_functions(played.chain.chain_id), set(marks)
        score = {uid: float(any(f(uid.encode()) in known for f in functions)) for uid in (*enrolled, *strangers)}
    else:
        registry = scheme.marks(enrolled)
        pepper = scheme.known_pepper
        # Without the pepper there is nothing to compare with but a pepper of one's own.
        tried = secrets.token_bytes(32) if pepper is None else pepper
        score = {
            uid: float(any(hash_uid(tried, mark.salt, uid.encode()) == mark.digest for mark in registry))
            for uid in (*enrolled, *strangers)
        }
    rng = np.random.default_rng([seed, 0xE7])
    hits: dict[int, list[float]] = defaultdict(list)
    for place, uid in enumerate(enrolled):
        for other in rng.integers(len(strangers), size=_TRIALS_A_PERSON_COUNT):
            hits[place].append(choice_score(score[uid], score[strangers[int(other)]]))
    return grouped_rate(hits, 0.5, seed=seed)


def attack_presence(
    played: Played, view: LedgerView, scheme: Scheme | None, *, seed: int, speaking: bool = False
) -> Rate:
    """`scheme` None: ours, by handle and M; the paper's schemes: by a hash on records.

    `speaking`: include people with a consent statement that day; people with other activity count either way.
    """
    came, acts = _presence(played), _acts_by_day(view)
    marks = {number: (holder.handle, holder.keys.identity.public_key) for number, holder in played.holders.items()}
    spoken = {(day_of(word.at_ms), word.handle) for word in view.words if word.entry in SPEAKING_ENTRIES}
    spoke = {(day, number) for number, (handle, _) in marks.items() for day, known in spoken if known == handle}
    traces = _traces(played, came, scheme) if scheme is not None else {}
    rng = np.random.default_rng([seed, 0x9E5E])
    hits: dict[int, list[float]] = defaultdict(list)
    for day in range(played.population.days):
        people = [number for number in marks if speaking or (day, number) not in spoke]
        here = [number for number in people if (day, number) in came]
        away = [number for number in people if (day, number) not in came]
        for person in here if away else ():
            pair = (person, away[int(rng.integers(len(away)))])
            if scheme is None:
                found = [float(sum(day in acts.get(mark, ()) for mark in marks[number])) for number in pair]
            else:
                found = [float(_is_traced(played, number, scheme, traces[day])) for number in pair]
            hits[person].append(choice_score(*found))
    return grouped_rate(hits, 0.5, seed=seed)


def _traces(played: Played, came: set[tuple[int, int]], scheme: Scheme) -> dict[int, list[OwnerMark]]:
    traces: dict[int, list[OwnerMark]] = {day: [] for day in range(played.population.days)}
    for day, number in sorted(came):
        traces[day].append(scheme.mark(played.holders[number].person.uid))
    return traces


def _is_traced(played: Played, number: int, scheme: Scheme, traces: list[OwnerMark]) -> bool:
    uid = played.holders[number].person.uid
    registered = scheme.mark(uid)
    if any((mark.salt, mark.digest) == (registered.salt, registered.digest) for mark in traces):
        return True
    pepper = scheme.known_pepper
    return pepper is not None and any(hash_uid(pepper, mark.salt, uid.encode()) == mark.digest for mark in traces)


def _presence(played: Played) -> set[tuple[int, int]]:
    stays = [played.population.stays[number] for number in played.truth.stay_of_owner.values()]
    return {(stay.day, stay.person) for stay in stays}


def _acts_by_day(view: LedgerView) -> dict[bytes, set[int]]:
    found: dict[bytes, set[int]] = defaultdict(set)
    for word in view.words:
        for mark in (word.handle, word.key):
            found[mark].add(day_of(word.at_ms))
    for handle, key, at_ms in view.registrations:
        for mark in (handle, key):
            found[mark].add(day_of(at_ms))
    return dict(found)


class _Ledger:
    """The chain's state as node sessions read it."""

    def __init__(self, chain: Chain) -> None:
        self._chain = chain

    def snapshot(self) -> _Ledger:
        return self

    def __enter__(self) -> _Ledger:
        return self

    def __exit__(self, *exception: object) -> None:
        return None

    def get(self, key: bytes) -> bytes | None:
        return self._chain.state.get(key)

    def scan(self, prefix: bytes, limit: int) -> object:
        return self._chain.state.scan(prefix, limit)


def probe_standing(played: Played, *, seed: int) -> Rate:
    """Test whether a node's rejections tell members' keys from strangers'."""
    chain = played.chain
    table = SessionTable(chain.chain_id, "node-1", chain, _Ledger(chain))  # type: ignore[arg-type]
    pool = Mempool(
        chain_id=chain.chain_id,
        cache=TransactionCache(),
        check_admission=lambda transaction: MEMBER.has(chain.state, transaction.body.sender),
        is_spent=lambda _: False,
    )
    members = [holder.keys.identity.public_key for holder in played.holders.values()]
    hits: dict[int, list[float]] = defaultdict(list)
    for number in range(PROBES_COUNT):
        place = number % len(members)
        stranger = PrivateKey(secrets.token_bytes(32)).public_key
        answers = [_answers(table, pool, chain, key) for key in (members[place], stranger)]
        hits[place].append(0.5 if answers[0] == answers[1] else 1.0)
    return grouped_rate(hits, 0.5, seed=seed)


def _answers(table: SessionTable, pool: Mempool, chain: Chain, key: bytes) -> tuple[str, str]:
    try:
        challenge, _ = table.challenge(key)
        table.open(key, challenge, bytes(65))
        session = "OK"
    except BlockRobotError as error:
        session = error.code
    genuine = chain.sign(PrivateKey(secrets.token_bytes(32)), "identity", "authenticate", [bytes(32)])
    forged = _with_sender(genuine.wire, key)
    try:
        pool.admit(forged, chain.now_ms())
        return session, "OK"
    except BlockRobotError as error:
        return session, redact_for_clients(error).code


def _with_sender(wire: bytes, sender: bytes) -> bytes:
    signed = decode(wire, TransactionWire)
    body = msgspec.structs.replace(decode(signed.body, TransactionBody), sender=sender)
    return encode(TransactionWire(body=encode(body), signature=signed.signature))
