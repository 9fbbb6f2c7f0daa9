"""`directory.json`: another node's directory, trusted like genesis until the own chain reaches its height."""

from __future__ import annotations

from pathlib import Path

import msgspec

from consensus.bounded_text import read_json_as
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from node.directory.node_directory import DirectoryContent, DirectoryNode, DirectoryOrganisation, content_of_genesis

DIRECTORY_FILE = "directory.json"


class _NodeRow(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    organisation: str
    host: str
    p2p_port: int
    api_url: str
    producer_key: str
    custodian_key: str
    is_active: bool
    since_height: int


class _OrganisationRow(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    ca_certificate: str
    is_active: bool


class _File(msgspec.Struct, forbid_unknown_fields=True):
    chain_id: str
    height: int
    nodes: list[_NodeRow]
    organisations: list[_OrganisationRow]
    revoked: list[tuple[str, str]]


def encode_directory(chain_id: bytes, content: DirectoryContent) -> bytes:
    nodes = [
        _NodeRow(
            name=node.name,
            organisation=node.organisation,
            host=node.host,
            p2p_port=node.p2p_port,
            api_url=node.api_url,
            producer_key=node.producer_key.hex(),
            custodian_key=node.custodian_key.hex(),
            is_active=node.is_active,
            since_height=node.since_height,
        )
        for node in content.nodes.values()
    ]
    organisations = [
        _OrganisationRow(name=item.name, ca_certificate=item.ca_certificate, is_active=item.is_active)
        for item in content.organisations.values()
    ]
    revoked = sorted((organisation, f"{serial:x}") for organisation, serial in content.revoked)
    whole = _File(chain_id.hex(), content.height, nodes, organisations, revoked)
    return msgspec.json.format(msgspec.json.encode(whole), indent=2) + b"\n"


def decode_directory(data: bytes, chain_id: bytes) -> DirectoryContent:
    """Raises CONFIGURATION_INVALID if it is damaged or of another chain."""
    try:
        whole = read_json_as(data, _File)
        content = DirectoryContent(
            height=whole.height,
            nodes={row.name: _to_node(row) for row in whole.nodes},
            organisations={
                row.name: DirectoryOrganisation(row.name, row.ca_certificate, row.is_active)
                for row in whole.organisations
            },
            revoked=frozenset((organisation, int(serial, 16)) for organisation, serial in whole.revoked),
        )
    except ValueError as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"{DIRECTORY_FILE} cannot be read: {error}.") from None
    if whole.chain_id != chain_id.hex():
        raise BlockRobotError("CONFIGURATION_INVALID", f"{DIRECTORY_FILE} is of another network than the genesis file.")
    return content


def _to_node(row: _NodeRow) -> DirectoryNode:
    return DirectoryNode(
        name=row.name,
        organisation=row.organisation,
        host=row.host,
        p2p_port=row.p2p_port,
        api_url=row.api_url,
        producer_key=bytes.fromhex(row.producer_key),
        custodian_key=bytes.fromhex(row.custodian_key),
        is_active=row.is_active,
        since_height=row.since_height,
    )


def newest_beginning(data_dir: Path, genesis: Genesis) -> DirectoryContent:
    """The file's if present, else the genesis file's. Raises CONFIGURATION_INVALID."""
    path = data_dir / DIRECTORY_FILE
    if not path.exists():
        return content_of_genesis(genesis)
    return decode_directory(path.read_bytes(), genesis.chain_id)
