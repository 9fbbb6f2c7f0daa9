"""What founders of a network hand to each other: signed entries of organisations and of their nodes, public files.

An organisation's entry is signed by each of its keys, a node's by an admin of its organisation and by its custodian's key,
so that nobody enters a key, or a node, of somebody else. (A producer's key is proved in the entry itself.)
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from consensus.bounded_text import read_json_text
from consensus.chain.genesis import NodeEntry, Organisation
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, encode
from consensus.primitives.keys import PrivateKey, verify
from network.provisioning.exchange_files import read_node_entry, read_organisation_entry, read_public_text

ORGANISATION_TAG, NODE_TAG = "blockrobot/founding-organisation", "blockrobot/founding-node"
CUSTODIAN_TAG = "blockrobot/founding-custodian"
_PROOFS, _MADE_AT, _ADMIN, _SIGNATURE, _CUSTODIAN_PROOF = (
    "proofs",
    "made_at_ms",
    "admin",
    "signature",
    "custodian_proof",
)


class FoundingNode(Wire, frozen=True):
    """A node's entry and when it was made (ms): what the admin of its organisation signs."""

    entry: NodeEntry
    made_at_ms: int


@dataclass(frozen=True, slots=True)
class OrganisationOffer:
    """An organisation's entry, read from `source`, whose keys are all proved to be held."""

    source: str
    organisation: Organisation


@dataclass(frozen=True, slots=True)
class NodeOffer:
    """A node's entry, read from `source`; `admin` (33 bytes) signed it."""

    source: str
    entry: NodeEntry
    made_at_ms: int
    admin: bytes


def organisation_entry_to_json(entry: Organisation, keys: Sequence[PrivateKey]) -> str:
    """For `genesis make` and `org propose add-org`. `keys`: those of the admins, then of the registrars."""
    message = encode(entry)
    document = {
        "name": entry.name,
        "ca_certificate": entry.ca_certificate,
        "admins": [key.hex() for key in entry.admins],
        "registrars": [key.hex() for key in entry.registrars],
        _PROOFS: [key.sign_compact(ORGANISATION_TAG, message).hex() for key in keys],
    }
    return json.dumps(document, indent=2) + "\n"


def node_entry_to_json(
    entry: NodeEntry, made_at_ms: int = 0, admin: PrivateKey | None = None, custodian: PrivateKey | None = None
) -> str:
    """For `genesis make` if an admin and its custodian's key sign it, and for `org propose add-node`."""
    shown = {name: value.hex() if isinstance(value, bytes) else value for name, value in _fields(entry).items()}
    if admin is not None:
        message = encode(FoundingNode(entry=entry, made_at_ms=made_at_ms))
        shown[_MADE_AT] = made_at_ms
        shown[_ADMIN], shown[_SIGNATURE] = admin.public_key.hex(), admin.sign_compact(NODE_TAG, message).hex()
        if custodian is not None:
            shown[_CUSTODIAN_PROOF] = custodian.sign_compact(CUSTODIAN_TAG, message).hex()
    return json.dumps(shown, indent=2) + "\n"


def _fields(entry: NodeEntry) -> Mapping[str, Any]:
    return {name: getattr(entry, name) for name in NodeEntry.__struct_fields__}


def read_offers(paths: Sequence[Path]) -> tuple[list[OrganisationOffer], list[NodeOffer]]:
    """Read entries of either kind; files with the same content count once.

    Raises FOUNDING_ENTRY_INVALID, FILE_HOLDS_PRIVATE_KEY, FILE_UNUSABLE.
    """
    organisations: dict[str, OrganisationOffer] = {}
    nodes: dict[str, NodeOffer] = {}
    for path in paths:
        text = read_public_text(path)
        try:
            document = read_json_text(text)
        except ValueError:
            document = None
        if not isinstance(document, dict):
            raise BlockRobotError("FILE_UNUSABLE", f"{path} is no entry of an organisation or a node.")
        if "ca_certificate" in document:
            organisations.setdefault(text, _organisation_offer(path, document))
        else:
            nodes.setdefault(text, _node_offer(path, document))
    return list(organisations.values()), list(nodes.values())


def _organisation_offer(path: Path, document: Mapping[str, Any]) -> OrganisationOffer:
    fields = read_organisation_entry(path)
    organisation = Organisation(
        name=fields["name"],
        ca_certificate=fields["ca_certificate"],
        admins=tuple(fields["admins"]),
        registrars=tuple(fields["registrars"]),
    )
    keys, message = [*organisation.admins, *organisation.registrars], encode(organisation)
    try:
        proofs = [bytes.fromhex(proof) for proof in document[_PROOFS]]
        proved = [verify(key, ORGANISATION_TAG, proof, message) for key, proof in zip(keys, proofs, strict=True)]
    except (KeyError, TypeError, ValueError):
        raise refuse(
            path, "does not prove that its organisation holds its keys; make it by `blockrobot org new`"
        ) from None
    if not all(proved):
        raise refuse(path, "was changed after its organisation signed it, or names a key of somebody else")
    return OrganisationOffer(str(path), organisation)


def _node_offer(path: Path, document: Mapping[str, Any]) -> NodeOffer:
    fields = read_node_entry(path)
    try:
        entry = msgspec.convert(list(fields.values()), NodeEntry, builtin_types=(bytes,))
        made_at_ms = msgspec.convert(document[_MADE_AT], int)
        admin, signature = (bytes.fromhex(document[name]) for name in (_ADMIN, _SIGNATURE))
        proof = bytes.fromhex(document[_CUSTODIAN_PROOF]) if entry.custodian_key else b""
        message = encode(FoundingNode(entry=entry, made_at_ms=made_at_ms))
    except (KeyError, TypeError, ValueError, OverflowError):
        raise refuse(path, "is not signed by its organisation; make it by `blockrobot node init --founding`") from None
    if not verify(admin, NODE_TAG, signature, message):
        raise refuse(path, "was changed after its organisation signed it")
    if entry.custodian_key and not verify(entry.custodian_key, CUSTODIAN_TAG, proof, message):
        raise refuse(path, "does not prove that its node holds the custodian key, which may be somebody else's")
    return NodeOffer(str(path), entry, made_at_ms, admin)


def refuse(source: Path | str, what: str) -> BlockRobotError:
    return BlockRobotError("FOUNDING_ENTRY_INVALID", f"{source} {what}.")
