"""Organisations' public notices, proved, without a session."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient
from clients.sdk.proof_checks import ProvedState
from consensus.api_documents import ProofsRequest
from consensus.errors import BlockRobotError
from consensus.members.vouchers import Card, recover_registrar
from consensus.rights.notices import (
    NoticeVersion,
    PublishedNotice,
    read_published,
    read_row,
)
from consensus.state.consent import NOTICE, NOTICE_TEXT
from consensus.state.identity import REGISTRAR


async def public_values(client: NetworkClient, keys: Sequence[bytes]) -> ProvedState:
    """About organisations, without a session. Raises PROOF_*, NOT_PERMITTED."""
    body = msgspec.json.encode(ProofsRequest([key.hex() for key in keys]))

    async def ask(node: NodeAddress) -> bytes:
        return await client.ask_node(node, "POST", "/v1/notice-proofs", body=body)

    return await client.prove_public(ask, keys)


async def read_newest(client: NetworkClient, organisation: str) -> NoticeVersion | None:
    """In force; None if never published."""
    key = NOTICE.key(organisation)
    return read_row(organisation, (await public_values(client, [key])).values[key])


async def read_version(client: NetworkClient, organisation: str, version: int) -> PublishedNotice:
    """With its text. Raises NOTICE_NOT_FOUND, NOTICE_INVALID."""
    key = NOTICE_TEXT.key(version, organisation)
    found = read_published(organisation, (await public_values(client, [key])).values[key])
    if found is None:
        raise BlockRobotError("NOTICE_NOT_FOUND", f"{organisation} published no version {version}.")
    return found


async def read_notice(client: NetworkClient, organisation: str) -> PublishedNotice | None:
    """In force, with text. Raises NOTICE_INVALID."""
    row = await read_newest(client, organisation)
    return None if row is None else await read_version(client, organisation, row.version)


async def organisation_of_card(client: NetworkClient, card: Card) -> str:
    """The issuer's, proved. Raises VOUCHER_INVALID if unknown."""
    key = REGISTRAR.key(recover_registrar(card, client.genesis.chain_id))
    name = (await public_values(client, [key])).values[key]
    if not isinstance(name, str):
        raise BlockRobotError("VOUCHER_INVALID", "The card was not issued by a registrar of this network.")
    return name
