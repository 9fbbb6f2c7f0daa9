"""Genesis files that are good for links and directories, not for a chain. For the tests of this folder and below."""

from __future__ import annotations

from collections.abc import Mapping

from consensus.chain.genesis import GENESIS_VERSION, ChainSettings, Genesis, NodeEntry, Organisation
from network.provisioning.certificate_authority import Authority


def small_genesis(authorities: Mapping[str, Authority]) -> Genesis:
    """A genesis file of these organisations, without nodes."""
    return Genesis(
        version=GENESIS_VERSION,
        network="small",
        created_at_ms=1_800_000_000_000,
        settings=ChainSettings(),
        organisations=tuple(
            Organisation(name=name, ca_certificate=authority.certificate_pem, admins=(), registrars=())
            for name, authority in authorities.items()
        ),
        nodes=(),
        contracts=(),
        purposes=(),
        state_root=bytes(32),
    )


def node_entry(name: str, organisation: str, port: int = 7272, producer_key: bytes = b"") -> NodeEntry:
    """A node of a genesis file."""
    return NodeEntry(
        name=name,
        organisation=organisation,
        host="127.0.0.1",
        p2p_port=port,
        api_url=f"http://127.0.0.1:{port + 1}",
        producer_key=producer_key,
        producer_possession=b"",
        custodian_key=b"",
    )
