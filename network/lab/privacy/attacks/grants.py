"""Names grantees from the chain alone by guessing weak secrets and unsalted hashes.

Handle hashes are tried with all public salts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from consensus.primitives.encoding import u64
from consensus.primitives.hashing import sha256
from consensus.records.sharing import hash_grant_member
from consensus.state.access import GRANT, GrantRow
from network.lab.privacy.attacks.ledger_view import VisitSeen
from network.lab.privacy.attacks.naming import PublicKeys, name_visits


@dataclass(frozen=True, slots=True)
class GrantSeen:
    """A grant as any reader of the state sees it."""

    grant_id: bytes
    entry: GrantRow


def read_grants(state: Mapping[bytes, bytes]) -> list[GrantSeen]:
    keys = sorted(filter(GRANT.owns, state))
    return [GrantSeen(GRANT.split(key)[0], GRANT.decode(state[key])) for key in keys]


def name_grantees(
    grants: Sequence[GrantSeen], people: Sequence[PublicKeys], handles: Sequence[bytes], chain_id: bytes
) -> dict[bytes, int]:
    named: dict[bytes, int] = {}
    seen = {grant.entry.grantee: grant.grant_id for grant in grants}
    visits = [_as_visit(grant.entry) for grant in grants]
    for grantee, place in name_visits(visits, people, chain_id).items():
        named[seen[grantee]] = place
    for grant in grants:
        hashes = {hash_grant_member(salt, handle): handle for salt in _salts(grant) for handle in handles}
        if grant.entry.member_hash in hashes:
            named[grant.grant_id] = handles.index(hashes[grant.entry.member_hash])
    return named


def link_grants(grants: Sequence[GrantSeen]) -> set[frozenset[bytes]]:
    linked: set[frozenset[bytes]] = set()
    for field in ("grantee", "ephemeral", "member_hash"):
        by_value: dict[bytes, list[bytes]] = {}
        for grant in grants:
            by_value.setdefault(getattr(grant.entry, field), []).append(grant.grant_id)
        for ids in by_value.values():
            linked.update(frozenset((ids[0], other)) for other in ids[1:])
    return linked


def _as_visit(entry: GrantRow) -> VisitSeen:
    return VisitSeen(
        owner=entry.grantee,
        ephemeral=entry.ephemeral,
        view_tag=entry.view_tag,
        robot=entry.owner,
        bucket_ms=entry.until_ms,
        at_ms=entry.time,
        height=entry.height,
        position=0,
    )


def _salts(grant: GrantSeen) -> Iterator[bytes]:
    entry = grant.entry
    yield bytes(32)
    yield grant.grant_id
    for public in (entry.grantee, entry.ephemeral, entry.owner, u64(entry.until_ms), *entry.records):
        yield sha256(public)
