"""The first state: the same on every node, and only with the very contracts that the file names."""

from __future__ import annotations

import msgspec
import pytest

from consensus.chain.genesis import ContractEntry, genesis_from_json, genesis_to_json
from consensus.errors import BlockRobotError
from consensus.limits import GRANTS_OPEN_MAX_COUNT, RECORDS_A_CALL_MAX_COUNT
from consensus.primitives.encoding import EXACT_INTEGER_END, decode_value
from contracts.execution.genesis import build_genesis_state, complete_genesis, open_genesis
from contracts.lifecycle import registry
from contracts.lifecycle.registry import (
    SHIPPED_CONTRACTS,
    compute_source_hash,
    contract_entries,
    load_contracts,
    read_source,
    require_contracts,
)
from contracts.state.trie import compute_root
from contracts.vm import LANGUAGE_VERSION
from tests.unit.contracts.privacy.hospital import build_genesis, key_of


@pytest.mark.parametrize(
    ("contract", "name", "value"),
    [
        ("access", "GRANTS_OPEN_MAX_COUNT", GRANTS_OPEN_MAX_COUNT),
        ("producers", "NUMBER_MAX", EXACT_INTEGER_END),
        ("records", "RECORDS_A_CALL_MAX_COUNT", RECORDS_A_CALL_MAX_COUNT),
    ],
)
def test_a_contract_and_the_programs_have_the_same_limit(contract: str, name: str, value: int) -> None:
    assert f"\n{name} = {value}\n" in read_source(contract)


def test_the_first_state_holds_organisations_custodians_and_purposes() -> None:
    state = open_genesis(build_genesis())
    org = decode_value(state.writes[b"identity\x00org/ward"])
    assert org == {"admins": [key_of("admin").public_key], "registrars": [key_of("registrar").public_key]}
    assert decode_value(state.writes[b"identity\x00registrar/" + key_of("registrar").public_key]) == "ward"
    custodians = sorted(key_of(name).public_key for name in ("custodian-1", "custodian-2"))
    assert decode_value(state.writes[b"identity\x00custodians"]) == custodians
    assert b"identity\x00purpose/care" in state.writes
    assert state.state_root == compute_root(state.writes.items())


def test_the_file_survives_json_and_completing_it_again_changes_nothing() -> None:
    genesis = build_genesis()
    read = genesis_from_json(genesis_to_json(genesis))
    assert read == genesis
    assert open_genesis(read) == build_genesis_state(genesis)
    assert genesis.block().header.state_root == genesis.state_root
    assert complete_genesis(genesis) == genesis
    assert complete_genesis(msgspec.structs.replace(genesis, state_root=b"")).chain_id == genesis.chain_id


def test_another_root_language_or_contract_in_the_file_is_refused_on_start() -> None:
    genesis = msgspec.structs.replace(build_genesis(), state_root=bytes(32))
    with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
        open_genesis(genesis)
    # With other prices of gas the node would come to other results, and halt in the middle of the chain.
    genesis = msgspec.structs.replace(build_genesis(), contract_language=LANGUAGE_VERSION + 1)
    for start in (require_contracts, open_genesis):
        with pytest.raises(BlockRobotError, match=r"GENESIS_INVALID.*language"):
            start(genesis)
    genesis = build_genesis()
    other = ContractEntry(name="identity", source_hash=bytes(32))
    for contracts in ((), genesis.contracts[1:], (*genesis.contracts[:-1], other)):
        with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
            require_contracts(msgspec.structs.replace(genesis, contracts=contracts))


def test_after_the_start_no_source_is_read_from_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where contracts run in a sandbox, nothing can be opened any more: a return to what shipped must not need it."""
    genesis = build_genesis()
    registry._shipped_sources.cache_clear()
    require_contracts(genesis)
    monkeypatch.setattr(registry, "read_source", None)
    for entry in genesis.contracts:
        assert registry.find_shipped_source(entry.source_hash) is not None


def test_one_key_in_another_role_is_another_state() -> None:
    genesis = build_genesis()
    changed = msgspec.structs.replace(genesis, purposes=("care",))
    assert build_genesis_state(changed).state_root != genesis.state_root


def test_the_contracts_ship_as_data_and_compile() -> None:
    assert tuple(load_contracts()) == SHIPPED_CONTRACTS
    assert [entry.name for entry in contract_entries()] == list(SHIPPED_CONTRACTS)
    assert compute_source_hash(read_source("audit")) != compute_source_hash(read_source("audit") + "\n")
    with pytest.raises(BlockRobotError, match="TRANSACTION_CONTRACT_UNKNOWN"):
        read_source("../execution/registry")
