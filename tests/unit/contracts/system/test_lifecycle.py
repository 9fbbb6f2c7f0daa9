"""Contracts come, change, rest and return: as a majority decides, at the beginning of the very block it decided on."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.limits import CALL_GAS_MAX
from contracts.execution.registry import SHIPPED_CONTRACTS, compute_source_hash, read_source
from tests.unit.contracts.system.consortium import Consortium, admin_of, data_of, key_of
from tests.unit.contracts.system.deploying import (
    FAILING,
    VISITORS,
    VISITORS_2,
    activation,
    agree,
    deploy,
    deployment,
    disabling,
    parts_of,
    upload,
)

ANYONE = key_of("anyone")


@pytest.fixture
def chain() -> Consortium:
    return Consortium(organisations=3, nodes=3)


def version_of(chain: Consortium, name: str, number: int) -> dict[str, Any]:
    return dict(chain.view("lifecycle", "version", name, number))


def test_genesis_lists_the_shipped_contracts_as_their_first_version(chain: Consortium) -> None:
    rows = chain.view("lifecycle", "contracts")
    assert [row[0] for row in rows] == sorted(SHIPPED_CONTRACTS)
    for name, version, source_hash, enabled, since in rows:
        assert (version, enabled, since) == (1, True, 0)
        assert source_hash == compute_source_hash(read_source(name))
    assert chain.view("lifecycle", "version", "records", 1)["status"] == "active"


def test_a_contract_answers_from_the_block_after_its_approval(chain: Consortium) -> None:
    before = chain.send(ANYONE, "visitors", "enter", "Ada")
    assert (before.ok, before.code) == (False, "CONTRACT_UNKNOWN")
    height = deploy(chain, "visitors", VISITORS)
    assert height == chain.height + 1
    chain.must(ANYONE, "visitors", "enter", "Ada")
    assert chain.height == height
    assert chain.view("visitors", "inside") == ["Ada"]
    record = version_of(chain, "visitors", 1)
    assert (record["status"], record["since_height"], record["organisation"]) == ("active", height, "org-01")


def test_a_contract_waits_for_the_height_it_was_given(chain: Consortium) -> None:
    height = deploy(chain, "visitors", VISITORS, height=chain.height + 12)
    while chain.height < height - 1:
        assert chain.send(ANYONE, "visitors", "enter", "Ada").code == "CONTRACT_UNKNOWN"
    assert version_of(chain, "visitors", 1)["status"] == "approved"
    chain.must(ANYONE, "visitors", "enter", "Ada")
    assert chain.height == height
    assert deploy(chain, "others", VISITORS, delay=5) == chain.height + 5


def test_an_upgrade_carries_the_state_over_before_the_first_transaction(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.must(ANYONE, "visitors", "enter", "Ada")
    deploy(chain, "visitors", VISITORS_2)
    chain.must(ANYONE, "visitors", "enter", "Bob", 2)
    assert chain.view("visitors", "inside") == [["Ada", 0], ["Bob", 2]]
    assert chain.value("visitors", b"in/Ada") is None
    assert version_of(chain, "visitors", 1)["status"] == "superseded"
    assert chain.view("lifecycle", "contract", "visitors")["version"] == 2


def test_an_upgrade_takes_effect_in_an_empty_block_too(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    assert chain.block([]) == []
    assert chain.view("visitors", "inside") == []


def test_a_failed_migration_leaves_the_old_version_and_says_why(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.must(ANYONE, "visitors", "enter", "Ada")
    height = deploy(chain, "visitors", FAILING)
    chain.must(ANYONE, "visitors", "enter", "Bob")
    assert chain.view("visitors", "inside") == ["Ada", "Bob"]
    record = version_of(chain, "visitors", 2)
    assert (record["status"], record["since_height"]) == ("failed", height)
    assert record["failure"] == "TOO_EARLY: Not yet. (line 17)"
    assert version_of(chain, "visitors", 1)["status"] == "active"


def test_a_migration_that_never_ends_is_cut_off(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.block([])
    deploy(chain, "visitors", VISITORS_2.replace("for key, height", "while True:\n        pass\n    for key, height"))
    chain.block([])
    assert version_of(chain, "visitors", 2)["failure"].startswith("OUT_OF_GAS")
    assert chain.view("visitors", "inside") == []


def test_a_disabled_contract_answers_nobody_and_can_return(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.must(ANYONE, "visitors", "enter", "Ada")
    agree(chain, "disable", disabling("visitors"))
    refused = chain.send(ANYONE, "visitors", "enter", "Bob")
    assert (refused.ok, refused.code) == (False, "CONTRACT_DISABLED")
    agree(chain, "activate", activation("visitors", 1))
    chain.must(ANYONE, "visitors", "enter", "Bob")
    assert chain.view("visitors", "inside") == ["Ada", "Bob"]


def test_disabling_takes_back_what_was_due(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.block([])
    deploy(chain, "visitors", VISITORS_2, delay=20)
    agree(chain, "disable", disabling("visitors"))
    for _ in range(25):
        chain.block([])
    assert chain.send(ANYONE, "visitors", "enter", "Bob", 1).code == "CONTRACT_DISABLED"


def test_an_earlier_version_comes_back_by_activation(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.block([])
    deploy(chain, "visitors", VISITORS_2)
    chain.block([])
    agree(chain, "activate", activation("visitors", 1))
    chain.must(ANYONE, "visitors", "leave", "Ada")
    assert version_of(chain, "visitors", 2)["status"] == "superseded"
    chain.refused("ACTIVE_ALREADY", admin_of("org-01"), "lifecycle", "propose", "activate", activation("visitors", 1))
    chain.refused("VERSION_UNKNOWN", admin_of("org-01"), "lifecycle", "propose", "activate", activation("visitors", 3))


def test_one_contract_changes_with_a_block(chain: Consortium) -> None:
    """So that no block has to carry over the states of many."""
    first = deploy(chain, "one", VISITORS, height=chain.height + 30)
    second = deploy(chain, "two", VISITORS, height=first)
    assert second == first + 1


def test_a_long_source_comes_in_parts_in_any_order(chain: Consortium) -> None:
    source = VISITORS + "".join(f"# {number:05d} {'x' * 60}\n" for number in range(830))
    assert 55_000 < len(source) < 60_000
    parts, key = parts_of(source), admin_of("org-01")
    assert len(parts) == 10
    for place in reversed(range(1, len(parts))):
        chain.must(key, "lifecycle", "upload", compute_source_hash(source), len(parts), place, parts[place])
    chain.refused("SOURCE_MISSING", key, "lifecycle", "propose", "deploy", deployment("visitors", source))
    chain.must(key, "lifecycle", "upload", compute_source_hash(source), len(parts), 0, parts[0])
    agree(chain, "deploy", deployment("visitors", source))
    chain.must(ANYONE, "visitors", "enter", "Ada")
    assert chain.view("lifecycle", "uploads", "org-01") == []
    assert chain.value("lifecycle", b"upload/org-01/" + compute_source_hash(source) + bytes(4)) is None


def test_what_is_not_in_the_language_is_refused(chain: Consortium) -> None:
    key = admin_of("org-01")
    for source in ("import os\n", "def f(:\n", "x" * 7000, VISITORS.replace("ctx.height", "open('x')")):
        upload(chain, key, source)
        chain.refused("SOURCE_INVALID", key, "lifecycle", "propose", "deploy", deployment("visitors", source))


def test_parts_that_give_another_hash_are_refused(chain: Consortium) -> None:
    key, source_hash = admin_of("org-01"), compute_source_hash(VISITORS)
    chain.must(key, "lifecycle", "upload", source_hash, 1, 0, VISITORS_2.encode())
    chain.refused("SOURCE_OTHER", key, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS))


def test_a_part_that_is_exchanged_after_the_proposal_stops_the_approval(chain: Consortium) -> None:
    key, source_hash = admin_of("org-01"), compute_source_hash(VISITORS)
    upload(chain, key, VISITORS)
    proposal_id = chain.must(key, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS)).txid
    chain.must(key, "lifecycle", "upload", source_hash, 1, 0, VISITORS_2.encode())
    chain.refused("SOURCE_MISSING", admin_of("org-02"), "lifecycle", "approve", proposal_id)
    upload(chain, key, VISITORS)
    again = chain.must(key, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS)).txid
    chain.must(admin_of("org-02"), "lifecycle", "approve", again)


def test_an_organisation_keeps_four_uploads_and_one_cannot_push_out_anothers(chain: Consortium) -> None:
    sources = [VISITORS + f"# {number}\n" for number in range(6)]
    upload(chain, admin_of("org-02"), sources[0])
    for source in sources:
        upload(chain, admin_of("org-01"), source)
    kept = [entry["source_hash"] for entry in chain.view("lifecycle", "uploads", "org-01")]
    assert kept == [compute_source_hash(source) for source in sources[2:]]
    assert len(chain.view("lifecycle", "uploads", "org-02")) == 1
    dropped = deployment("visitors", sources[0])
    chain.refused("SOURCE_MISSING", admin_of("org-01"), "lifecycle", "propose", "deploy", dropped)
    chain.must(admin_of("org-02"), "lifecycle", "propose", "deploy", dropped)


@pytest.mark.parametrize(
    ("kind", "change", "code"),
    [
        ("deploy", {"name": "state"}, "NAME_WRONG"),
        ("deploy", {"name": "1st"}, "NAME_WRONG"),
        ("deploy", {"name": "Visitors"}, "NAME_WRONG"),
        ("deploy", {"name": 5}, "FIELDS_WRONG"),
        ("deploy", {"height": -1}, "HEIGHT_WRONG"),
        ("deploy", {"delay": 1 << 40}, "HEIGHT_WRONG"),
        ("deploy", {"note": "x" * 281}, "NOTE_WRONG"),
        ("deploy", {"more": 1}, "FIELDS_WRONG"),
        ("destroy", {}, "KIND_UNKNOWN"),
    ],
)
def test_a_proposal_that_is_not_well_formed_is_refused(
    chain: Consortium, kind: str, change: dict[str, Any], code: str
) -> None:
    upload(chain, admin_of("org-01"), VISITORS)
    chain.refused(code, admin_of("org-01"), "lifecycle", "propose", kind, deployment("visitors", VISITORS) | change)


def test_the_price_of_a_source_follows_its_length(chain: Consortium) -> None:
    source_hash = bytes(32)
    short = chain.must(admin_of("org-01"), "lifecycle", "upload", source_hash, 2, 0, bytes(1000))
    long = chain.must(admin_of("org-01"), "lifecycle", "upload", source_hash, 2, 1, bytes(6000))
    assert 40 * 5000 <= long.gas_used - short.gas_used <= 44 * 5000
    event = data_of(long, "uploaded")
    assert (event["place"], event["parts"]) == (1, 2)


def test_the_largest_part_fits_into_a_call_also_when_it_drops_ten_others(chain: Consortium) -> None:
    key = admin_of("org-01")
    for number in range(4):
        for place in range(10):
            chain.must(key, "lifecycle", "upload", bytes([number]) * 32, 10, place, bytes(6000))
    dropping = chain.must(key, "lifecycle", "upload", bytes([4]) * 32, 10, 0, bytes(6000))
    assert dropping.gas_used < CALL_GAS_MAX - 2_000
    kept = [entry["source_hash"][0] for entry in chain.view("lifecycle", "uploads", "org-01")]
    assert kept == [1, 2, 3, 4]
    assert list(chain.state.scan(b"lifecycle\x00upload/org-01/" + bytes(32), 20)) == []
