"""The genesis file: everything that a client trusts, in one readable file that says one thing."""

from __future__ import annotations

import json

import msgspec
import pytest

from consensus.chain.block import NO_BLOCK, compute_header_id
from consensus.chain.genesis import (
    ChainSettings,
    ContractEntry,
    Genesis,
    NodeEntry,
    Organisation,
    genesis_from_json,
    genesis_to_json,
)
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from tests.sim.named_chain import make_keys

KEYS = make_keys(3)


def node(name, producer=b"", custodian=b""):
    return NodeEntry(
        name=name,
        organisation="ward",
        host="127.0.0.1",
        p2p_port=7000,
        api_url="https://127.0.0.1:7001",
        producer_key=producer,
        producer_possession=b"\x02" * 64 if producer else b"",
        custodian_key=custodian,
    )


GENESIS = Genesis(
    version=1,
    network="Klinik für Geriatrie",
    created_at_ms=1_800_000_000_000,
    settings=ChainSettings(blocks_per_turn=2),
    organisations=(
        Organisation(name="ward", ca_certificate="-----BEGIN-----\n", admins=(KEYS[0].public_key,), registrars=()),
    ),
    nodes=(node("a", KEYS[0].public_key), node("b", custodian=KEYS[1].public_key), node("c", KEYS[2].public_key)),
    contracts=(ContractEntry(name="records", source_hash=sha256(b"source")),),
    purposes=("treatment", "research"),
    state_root=sha256(b"state"),
)


def refused(text):
    with pytest.raises(BlockRobotError, match=r"^GENESIS_INVALID:"):
        genesis_from_json(text)


def test_the_file_is_read_by_people_and_comes_back_as_it_was_written():
    assert genesis_from_json(genesis_to_json(GENESIS)) == GENESIS
    raw = json.loads(genesis_to_json(GENESIS))
    assert raw["network"] == "Klinik für Geriatrie"
    assert raw["nodes"][0]["producer_key"] == KEYS[0].public_key.hex()
    assert "für" in genesis_to_json(GENESIS)


def test_the_schedule_is_the_nodes_with_a_producer_key_in_file_order():
    assert GENESIS.schedule.producers == (KEYS[0].public_key, KEYS[2].public_key)
    assert GENESIS.schedule.blocks_per_turn == 2
    assert [entry.name for entry in GENESIS.custodians] == ["b"]


def test_the_chain_id_covers_everything_but_the_state_root():
    assert msgspec.structs.replace(GENESIS, state_root=b"").chain_id == GENESIS.chain_id
    for changes in (
        {"network": "other"},
        {"created_at_ms": 1},
        {"settings": ChainSettings()},
        {"nodes": GENESIS.nodes[:2]},
        {"purposes": ()},
    ):
        assert msgspec.structs.replace(GENESIS, **changes).chain_id != GENESIS.chain_id


def test_the_genesis_block_holds_the_genesis_state_and_another_state_is_another_block():
    block = GENESIS.block()
    header = block.header
    assert (header.height, header.round, header.parent_id) == (0, 0, NO_BLOCK)
    assert header.state_root == GENESIS.state_root
    assert header.timestamp_ms == GENESIS.created_at_ms
    assert GENESIS.block_id == block.block_id == compute_header_id(header)
    assert msgspec.structs.replace(GENESIS, state_root=bytes(32)).block_id != GENESIS.block_id


def test_a_node_is_found_by_name():
    assert GENESIS.node("c").producer_key == KEYS[2].public_key
    with pytest.raises(BlockRobotError, match="names no node 'z'"):
        GENESIS.node("z")


def changed(*path, value=None, remove=False):
    """Return the file's text with one place changed or removed."""
    raw = json.loads(genesis_to_json(GENESIS))
    place = raw
    for key in path[:-1]:
        place = place[key]
    if remove:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return json.dumps(raw)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "{",
        "{}",
        changed("version", value=2),
        changed("version", value="1"),
        changed("state_root", value="xyz"),
        changed("state_root", value=None),
        changed("network", value=5),
        changed("purposes", remove=True),
        changed("more", value=1),
        changed("settings", "base_timeout_ms", value="500"),
        changed("settings", "base_timeout_ms", remove=True),
        changed("settings", value=None),
        changed("nodes", value=None),
        changed("nodes", 0, "producer_key", value="02zz"),
        changed("nodes", 0, "producer_key", value=7),
        changed("nodes", 0, "p2p_port", value="7000"),
        changed("nodes", 0, value=[]),
        changed("nodes", 0, "producer_key", value="02" + "ff" * 32),
        changed("nodes", 1, "custodian_key", value="02"),
        changed("nodes", 0, "name", value="b"),
        changed("state_root", value="00"),
        changed("settings", "blocks_per_turn", value=0),
        changed("settings", "base_timeout_ms", value=0),
        changed("settings", "timeout_cap_ms", value=499),
        changed("settings", "min_block_interval_ms", value=-1),
        changed("settings", "production", value="interval:0"),
        changed("organisations", 0, "admins", value=["zz"]),
        changed("organisations", 0, "admins", value=None),
        changed("contracts", 0, "source_hash", remove=True),
        "[" * 100_000,
    ],
)
def test_a_damaged_file_is_refused_with_a_plain_sentence(text):
    refused(text)


def test_a_chain_without_producers_is_refused():
    with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
        _ = msgspec.structs.replace(GENESIS, nodes=()).schedule


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('"created_at_ms": 1800000000000', '"created_at_ms": 18000000000000000000000'),
        ('"p2p_port": 7000', f'"p2p_port": {-(1 << 70)}'),
        ('"name": "records"', r'"name": "\ud800"'),
    ],
)
def test_what_has_no_canonical_form_is_refused_when_it_is_read_and_not_when_it_is_used(before, after):
    text = genesis_to_json(GENESIS)
    assert before in text
    refused(text.replace(before, after, 1))
