"""Names visits' owners by guessing a careless robot's secrets.

Tries secrets made from public data: guessing s, or its r, names the visit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from consensus.primitives.encoding import u64
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.keys import point_add, point_of, scalar_from_hash
from consensus.records.owner_keys import open_visit_keys
from network.lab.privacy.attacks.ledger_view import VisitSeen

_SHARED_TAG, _OWNER_TAG = "blockrobot/visit", "blockrobot/owner"

PublicKeys = tuple[bytes, bytes, bytes]
"""Of a person: M, S and V."""


def name_visits(visits: Sequence[VisitSeen], people: Sequence[PublicKeys], chain_id: bytes) -> dict[bytes, int]:
    named: dict[bytes, int] = {}
    for visit in visits:
        secrets = _found_secrets(visit, people)
        tweaks = [point_of(scalar_from_hash(tagged_hash(_OWNER_TAG, s))) for s in _shared_guesses(visit, chain_id)]
        for place, (member, spend, view) in enumerate(people):
            keys = {member, spend, view}
            keys.update(point_add(spend, tweak) for tweak in tweaks)
            keys.update(_drawn_from(secret, visit, view, spend, chain_id) for secret in secrets)
            if visit.owner in keys:
                named[visit.owner] = place
                break
    return named


def _found_secrets(visit: VisitSeen, people: Sequence[PublicKeys]) -> list[bytes]:
    guesses = [sha256(visit.robot + u64(visit.bucket_ms)), sha256(u64(visit.bucket_ms))]
    guesses += [sha256(member + u64(visit.bucket_ms)) for member, _, _ in people]
    return [guess for guess in guesses if point_of(guess) == visit.ephemeral]


def _shared_guesses(visit: VisitSeen, chain_id: bytes) -> Iterator[bytes]:
    for point in (visit.ephemeral, visit.robot):
        yield tagged_hash(_SHARED_TAG, chain_id, visit.robot, point)


def _drawn_from(secret: bytes, visit: VisitSeen, view: bytes, spend: bytes, chain_id: bytes) -> bytes:
    return open_visit_keys(secret, view, spend, chain_id=chain_id, robot=visit.robot).owner
