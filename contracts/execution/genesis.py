"""Builds the genesis state of a chain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.state.lifecycle import MACHINE_TABLE, TABLE
from contracts.execution.call_host import CallHost
from contracts.lifecycle.registry import describe_shipped, require_contracts
from contracts.state.trie import apply_batch
from contracts.state.view import MemoryState
from contracts.vm import CallContext, invoke

GENESIS_GAS_MAX = 50_000_000
_GENESIS_ENTRY = "genesis"


@dataclass(frozen=True, slots=True)
class GenesisState:
    """Initial encoded values by flat key, trie pages by nibble path, and root."""

    writes: dict[bytes, bytes]
    pages: dict[bytes, bytes]
    state_root: bytes


def _identity_arguments(genesis: Genesis) -> list[Any]:
    organisations = [[org.name, list(org.admins), list(org.registrars)] for org in genesis.organisations]
    custodians = [[node.custodian_key, node.name, node.organisation] for node in genesis.custodians]
    return [organisations, custodians, list(genesis.purposes)]


def _membership_arguments(genesis: Genesis) -> list[Any]:
    organisations = [[org.name, org.ca_certificate] for org in genesis.organisations]
    return [organisations, [list(msgspec.structs.astuple(node)) for node in genesis.nodes]]


def _producers_arguments(genesis: Genesis) -> list[Any]:
    producers = [[node.producer_key, node.name, node.organisation] for node in genesis.nodes if node.producer_key]
    organisations = [org.name for org in genesis.organisations]
    return [producers, organisations, msgspec.structs.asdict(genesis.settings)]


def build_genesis_state(genesis: Genesis) -> GenesisState:
    """Run the genesis entries, ignoring `genesis.state_root`. Raises GENESIS_INVALID."""
    contracts = require_contracts(genesis)
    state = MemoryState()
    host = CallHost(state)
    context = CallContext(
        caller=bytes(33), height=0, time_ms=genesis.created_at_ms, txid=bytes(32), chain_id=genesis.chain_id
    )
    first = {
        "lifecycle": [describe_shipped()],
        "identity": _identity_arguments(genesis),
        "membership": _membership_arguments(genesis),
        "producers": _producers_arguments(genesis),
    }
    for name, arguments in first.items():
        outcome = invoke(
            contracts,
            name,
            _GENESIS_ENTRY,
            arguments,
            host=host,
            context=context,
            gas_limit=GENESIS_GAS_MAX,
            mode="genesis",
        )
        if not outcome.ok:
            raise BlockRobotError("GENESIS_INVALID", f"The contracts refuse the genesis file: {outcome.message}")
        host.keep()
    host.put(MACHINE_TABLE.flat, host.writes[TABLE.flat] or b"")
    host.keep()
    update = apply_batch(state, state.state_root, host.writes)
    return GenesisState(
        writes={key: value for key, value in host.writes.items() if value is not None},
        pages={path: page for path, page in update.pages.items() if page is not None},
        state_root=update.root,
    )


def complete_genesis(genesis: Genesis) -> Genesis:
    """Raises GENESIS_INVALID."""
    return msgspec.structs.replace(genesis, state_root=build_genesis_state(genesis).state_root)


def open_genesis(genesis: Genesis) -> GenesisState:
    """Raises GENESIS_INVALID if roots differ."""
    state = build_genesis_state(genesis)
    if state.state_root != genesis.state_root:
        raise BlockRobotError("GENESIS_INVALID", "The genesis file's state root is not that of its contracts.")
    return state
