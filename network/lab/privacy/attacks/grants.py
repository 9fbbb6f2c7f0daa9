"""Naming with whom something was shared, from the chain alone: guesses at careless wallets and at unsalted hashes. Pure.

The grantee's key G is made as owner keys are, so whatever names visits is tried on grants; her handle's hash is tried with
every salt that is public.
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
    """A grant as every reader of the chain's state has it."""

    grant_id: bytes
    entry: GrantRow


def read_grants(state: Mapping[bytes, bytes]) -> list[GrantSeen]:
    """Return the grants among flat rows of a state, by id."""
    keys = sorted(filter(GRANT.owns, state))
    return [GrantSeen(GRANT.split(key)[0], GRANT.decode(state[key])) for key in keys]


def name_grantees(
    grants: Sequence[GrantSeen], people: Sequence[PublicKeys], handles: Sequence[bytes], chain_id: bytes
) -> dict[bytes, int]:
    """Return with whom each grant is (place in `people` and `handles`, by grant id), of those that a guess names."""
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
    """Return the pairs of grants that have a value in common by which one grantee could be followed."""
    linked: set[frozenset[bytes]] = set()
    for field in ("grantee", "ephemeral", "member_hash"):
        by_value: dict[bytes, list[bytes]] = {}
        for grant in grants:
            by_value.setdefault(getattr(grant.entry, field), []).append(grant.grant_id)
        for ids in by_value.values():
            linked.update(frozenset((ids[0], other)) for other in ids[1:])
    return linked


def _as_visit(entry: GrantRow) -> VisitSeen:
    """A grant seen as a visit: the visit's owner key stands where a visit has its robot's."""
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
    """Yield what a careless wallet might have taken for salt: nothing, and hashes of what stands beside it."""
    entry = grant.entry
    yield bytes(32)
    yield grant.grant_id
    for public in (entry.grantee, entry.ephemeral, entry.owner, u64(entry.until_ms), *entry.records):
        yield sha256(public)
