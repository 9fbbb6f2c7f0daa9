"""The directory says what the finalized state says, from the same height on at every node."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from msgspec.structs import replace as changed

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from network.provisioning.certificate_authority import Authority, create_authority
from node.directory.directory_file import decode_directory, encode_directory, newest_beginning
from node.directory.node_directory import Directory, DirectoryContent, content_of_genesis
from tests.unit.node.p2p.linked_nodes import Membership
from tests.unit.node.small_genesis import node_entry, small_genesis

KEY = bytes([2]) + bytes(32)
OTHER_KEY = bytes([3]) + bytes(32)


@pytest.fixture(scope="module")
def authority() -> Authority:
    return create_authority("hospital")


@pytest.fixture
def state(authority: Authority) -> Membership:
    state = Membership()
    state.put_organisation("hospital", authority.certificate_pem)
    state.put_node("n1", "hospital", 7001, producer_key=KEY)
    state.put_node("n2", "hospital", 7002)
    return state


def genesis_content(authority: Authority) -> DirectoryContent:
    """What a genesis file says that names one node."""
    nodes = (node_entry("n1", "hospital", 7001, KEY),)
    return content_of_genesis(changed(small_genesis({"hospital": authority}), nodes=nodes))


def test_it_begins_with_the_genesis_file_and_a_state_without_membership_changes_nothing(authority: Authority) -> None:
    directory = Directory(genesis_content(authority))
    assert directory.names == ["n1"]
    assert directory.name_of_producer(KEY) == "n1"
    assert directory.height == 0
    directory = Directory(genesis_content(authority))
    assert not directory.refresh(Membership(), 5)
    assert directory.names == ["n1"]


def test_it_follows_the_state_and_tells_who_listens(authority: Authority, state: Membership) -> None:
    directory = Directory(genesis_content(authority))
    told: list[list[str]] = []
    directory.add_listener(lambda changed: told.append(changed.names))
    assert directory.refresh(state, 1)
    assert not directory.refresh(state, 2)
    assert told == [["n1", "n2"]]
    assert directory.height == 2
    state.put_node("n1", "hospital", 7001, status="removed", producer_key=KEY)
    assert directory.refresh(state, 3)
    assert told[-1] == ["n2"]
    assert directory.node("n1") is None


def test_a_producer_keeps_its_name_for_those_who_remember_its_votes(authority: Authority, state: Membership) -> None:
    directory = Directory(genesis_content(authority))
    directory.refresh(state, 1)
    state.put_node("n1", "hospital", 7001, producer_key=OTHER_KEY)
    directory.refresh(state, 2)
    assert directory.name_of_producer(OTHER_KEY) == "n1"
    assert directory.name_of_producer(KEY) == "n1"


def test_the_nodes_of_a_removed_organisation_are_not_active(authority: Authority, state: Membership) -> None:
    directory = Directory(genesis_content(authority))
    state.put_organisation("hospital", authority.certificate_pem, status="removed")
    directory.refresh(state, 1)
    assert directory.names == []
    assert set(directory.content.nodes) == {"n1", "n2"}


def test_only_custodians_that_belong_to_the_network_are_named(authority: Authority, state: Membership) -> None:
    directory = Directory(genesis_content(authority))
    state.put_node("n1", "hospital", 7001, custodian_key=KEY)
    state.put_node("n2", "hospital", 7002, status="removed", custodian_key=OTHER_KEY)
    directory.refresh(state, 1)
    assert directory.custodians.keys() == {"n1"}


def test_revoked_serials_are_of_one_organisation(authority: Authority, state: Membership) -> None:
    directory = Directory(genesis_content(authority))
    state.revoke("hospital", 77)
    directory.refresh(state, 1)
    assert directory.content.revoked == {("hospital", 77)}


def test_blocks_that_wrote_no_membership_need_no_second_look(authority: Authority, state: Membership) -> None:
    directory = Directory(genesis_content(authority))
    assert directory.needs_refresh([{}], 1)  # the first look of all
    directory.refresh(state, 1)
    assert not directory.needs_refresh([{b"records\x00visit/x": b""}, {}], 2)
    assert directory.needs_refresh([{b"records\x00visit/x": b""}, {b"membership\x00node/n9": None}], 3)


def test_a_hint_holds_until_the_own_chain_has_reached_its_height(authority: Authority, state: Membership) -> None:
    """A node that joins late must not forget, while it reads old blocks, who is there now."""
    directory = Directory(replace(genesis_content(authority), height=50))
    assert not directory.needs_refresh([{b"membership\x00node/n2": b""}], 49)
    assert not directory.refresh(state, 49)
    assert directory.names == ["n1"]
    assert directory.needs_refresh([{}], 50)
    assert directory.refresh(state, 50)
    assert directory.names == ["n1", "n2"]


def test_what_no_contract_can_have_written_is_damage(authority: Authority, state: Membership) -> None:
    state.entries[b"membership\x00node/n3"] = encode_value({"name": "n3"})
    with pytest.raises(BlockRobotError, match="STORAGE_DAMAGED"):
        Directory(genesis_content(authority)).refresh(state, 1)


def test_the_file_of_a_directory_says_the_same_again(authority: Authority, state: Membership) -> None:
    directory = Directory(genesis_content(authority))
    state.revoke("hospital", 1 << 150)
    state.put_node("n2", "hospital", 7002, status="removed", custodian_key=OTHER_KEY)
    directory.refresh(state, 9)
    data = encode_directory(bytes(32), directory.content)
    assert decode_directory(data, bytes(32)) == directory.content
    with pytest.raises(BlockRobotError, match="another network"):
        decode_directory(data, bytes([1]) * 32)
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID"):
        decode_directory(data[:-20], bytes(32))


def test_a_data_directory_without_the_file_begins_with_genesis(authority: Authority, tmp_path: Path) -> None:
    genesis = small_genesis({"hospital": authority})
    assert newest_beginning(tmp_path, genesis) == content_of_genesis(genesis)
    content = replace(genesis_content(authority), height=4)
    (tmp_path / "directory.json").write_bytes(encode_directory(genesis.chain_id, content))
    assert newest_beginning(tmp_path, genesis) == content
