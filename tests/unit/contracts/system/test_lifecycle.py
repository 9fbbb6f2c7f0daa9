"""Contracts come, change, rest and return: as a majority decides, at the beginning of the very block it decided on."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import pytest

from consensus.limits import BLOCK_GAS_MAX, CALL_GAS_MAX
from contracts.lifecycle.registry import SHIPPED_CONTRACTS, compute_source_hash, read_source
from contracts.vm.compiler import compile_cache
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
    chain.refused("SOURCE_MISSING", key, "lifecycle", "check_upload", compute_source_hash(source))
    chain.must(key, "lifecycle", "upload", compute_source_hash(source), len(parts), 0, parts[0])
    chain.refused("SOURCE_UNCHECKED", key, "lifecycle", "propose", "deploy", deployment("visitors", source))
    chain.must(key, "lifecycle", "check_upload", compute_source_hash(source))
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
    chain.refused("SOURCE_OTHER", key, "lifecycle", "check_upload", source_hash)
    chain.refused("SOURCE_UNCHECKED", key, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS))
    upload(chain, key, VISITORS)
    chain.must(key, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS))


def test_a_part_cannot_be_exchanged_once_the_source_is_checked(chain: Consortium) -> None:
    key, source_hash = admin_of("org-01"), compute_source_hash(VISITORS)
    upload(chain, key, VISITORS)
    proposal_id = chain.must(key, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS)).txid
    root = chain.state.state_root
    for parts, data in ((1, VISITORS_2.encode()), (2, b"#"), (1, VISITORS.encode())):
        chain.must(key, "lifecycle", "upload", source_hash, parts, 0, data)
        assert chain.state.state_root == root
    chain.must(admin_of("org-02"), "lifecycle", "approve", proposal_id)
    chain.must(ANYONE, "visitors", "enter", "Ada")


def test_a_source_that_was_pushed_out_after_the_proposal_stops_the_approval(chain: Consortium) -> None:
    key = admin_of("org-01")
    upload(chain, key, VISITORS)
    proposal_id = chain.must(key, "lifecycle", "propose", "deploy", deployment("visitors", VISITORS)).txid
    for number in range(4):
        upload(chain, key, VISITORS + f"# {number}\n")
    chain.refused("SOURCE_MISSING", admin_of("org-02"), "lifecycle", "approve", proposal_id)
    upload(chain, key, VISITORS)
    chain.must(admin_of("org-02"), "lifecycle", "approve", proposal_id)


def test_an_organisation_keeps_four_uploads_and_one_cannot_push_out_anothers(chain: Consortium) -> None:
    texts = [VISITORS + f"# {number}\n" for number in range(6)]
    upload(chain, admin_of("org-02"), texts[0])
    for source in texts:
        upload(chain, admin_of("org-01"), source)
    kept = [entry["source_hash"] for entry in chain.view("lifecycle", "uploads", "org-01")]
    assert kept == [compute_source_hash(source) for source in texts[2:]]
    assert len(chain.view("lifecycle", "uploads", "org-02")) == 1
    dropped = deployment("visitors", texts[0])
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
        ("deploy", {"note": "fine\x1b[2J"}, "NOTE_WRONG"),
        ("deploy", {"note": "fine\u202eelif"}, "NOTE_WRONG"),
        ("deploy", {"note": "fine\nOK"}, "NOTE_WRONG"),
        ("deploy", {"note": "fine\x9b31m"}, "NOTE_WRONG"),
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


class Counting:
    """Stands for the compiler, remembers nothing, and counts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.texts: list[str] = []
        self._compile = compile_cache._compile.__wrapped__
        monkeypatch.setattr(compile_cache, "_compile", self)

    def __call__(self, source: str) -> Any:
        self.texts.append(source)
        return self._compile(source)


@pytest.mark.parametrize("source", [VISITORS, "import os\n"])
def test_an_upload_buys_one_compiling_whatever_comes_of_it(
    chain: Consortium, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    key, source_hash = admin_of("org-01"), compute_source_hash(source)
    upload(chain, key, source, checked=False)
    compiler = Counting(monkeypatch)
    chain.must(key, "lifecycle", "check_upload", source_hash)
    assert compiler.texts.count(source) == 1
    for number in range(3):
        chain.must(key, "lifecycle", "upload", source_hash, 1, 0, b"#")
        chain.must(key, "lifecycle", "check_upload", source_hash)
        chain.send(key, "lifecycle", "propose", "deploy", deployment(f"name-{number}", source, note="x" * 281))
        chain.send(key, "lifecycle", "propose", "deploy", deployment(f"name-{number}", source))
    assert compiler.texts.count(source) == 1


def test_what_has_another_hash_is_not_compiled(chain: Consortium, monkeypatch: pytest.MonkeyPatch) -> None:
    key, source_hash = admin_of("org-01"), compute_source_hash(VISITORS)
    compiler = Counting(monkeypatch)
    for last in (b"#", b" ", b"\n"):
        chain.must(key, "lifecycle", "upload", source_hash, 1, 0, VISITORS.encode() + last)
        chain.refused("SOURCE_OTHER", key, "lifecycle", "check_upload", source_hash)
    assert [text for text in compiler.texts if text.startswith(VISITORS)] == []


def test_a_source_is_compiled_once_for_all_its_names(chain: Consortium, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Counting(monkeypatch)
    monkeypatch.setattr(compile_cache, "_compile", lru_cache(compiler))
    for name in ("one", "two"):
        deploy(chain, name, VISITORS)
        chain.must(ANYONE, name, "enter", "Ada")
        assert chain.view(name, "inside") == ["Ada"]
    chain.must(ANYONE, "one", "leave", "Ada")
    assert (chain.view("one", "inside"), chain.view("two", "inside")) == ([], ["Ada"])
    assert compiler.texts.count(VISITORS) == 1


WIDE = "".join(
    f"@export\ndef entry_number_{number}(one: list[int], two: dict[str, int]):\n    pass\n" for number in range(98)
)


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        (WIDE, ""),
        (WIDE.replace("one:", "one_that_has_a_long_name:"), "The names and types of a contract's entries take at most"),
        ("".join(f"@export\ndef f{number}():\n    pass\n" for number in range(101)), "A contract has at most 100"),
        ("@export\ndef f():\n    return " + "y" * 50_000 + "\n", "Line 3 of the source: NAME_UNKNOWN: "),
        ("X = '\ufffd'\n", "Line 1 of the source: "),
    ],
)
def test_nothing_fails_after_the_compiling_also_of_the_largest_source(
    chain: Consortium, source: str, problem: str
) -> None:
    """A call that failed would give the upload back, and with it the next compiling. Two such calls fill a block."""
    key = admin_of("org-01")
    for number in range(3):
        upload(chain, key, VISITORS + f"# {number}\n")
    source += "#" * (60_000 - len(source.encode()))
    upload(chain, key, source, checked=False)
    receipt = chain.must(key, "lifecycle", "check_upload", compute_source_hash(source))
    assert BLOCK_GAS_MAX / 3 < 3 * 60_000 < receipt.gas_used < CALL_GAS_MAX - 20_000
    assert data_of(receipt, "checked")["problem"].startswith(problem)
    entry = chain.send(key, "lifecycle", "propose", "deploy", deployment("visitors", source))
    assert entry.code == ("SOURCE_INVALID" if problem else "OK")


def test_disabling_is_about_one_version(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS)
    chain.block([])
    key = admin_of("org-01")
    chain.refused("VERSION_OTHER", key, "lifecycle", "propose", "disable", disabling("visitors", 2))
    proposal_id = chain.must(key, "lifecycle", "propose", "disable", disabling("visitors", 1)).txid
    deploy(chain, "visitors", VISITORS_2)
    chain.block([])
    chain.refused("PROPOSAL_STALE", admin_of("org-02"), "lifecycle", "approve", proposal_id)
    agree(chain, "disable", disabling("visitors", 2))


def test_a_proposal_that_is_older_than_the_contract_as_it_is_takes_nothing_back(chain: Consortium) -> None:
    """The same source is proposed twice; what was not approved then would undo the next version unseen."""
    for name in ("org-01", "org-02"):
        upload(chain, admin_of(name), VISITORS)
    first = chain.must(admin_of("org-01"), "lifecycle", "propose", "deploy", deployment("visitors", VISITORS)).txid
    twin = deployment("visitors", VISITORS, note="again")
    second = chain.must(admin_of("org-02"), "lifecycle", "propose", "deploy", twin).txid
    chain.must(admin_of("org-02"), "lifecycle", "approve", first)
    chain.block([])
    chain.refused("PROPOSAL_STALE", admin_of("org-01"), "lifecycle", "approve", second)
    deploy(chain, "visitors", VISITORS_2)
    chain.block([])
    chain.refused("PROPOSAL_STALE", admin_of("org-01"), "lifecycle", "approve", second)
    assert chain.view("lifecycle", "contract", "visitors")["version"] == 2


def test_what_waits_counts_as_a_contract(chain: Consortium) -> None:
    first = len(chain.view("lifecycle", "contracts"))
    for number in range(first, 62):
        deploy(chain, f"c-{number}", VISITORS + f"# {number}\n")
        chain.block([])
    deploy(chain, "late", VISITORS, delay=50)
    opened = []
    for key, name in ((admin_of("org-01"), "later"), (admin_of("org-02"), "last")):
        upload(chain, key, VISITORS)
        opened.append(chain.must(key, "lifecycle", "propose", "deploy", deployment(name, VISITORS, delay=40)).txid)
    chain.must(admin_of("org-02"), "lifecycle", "approve", opened[0])
    chain.refused("CONTRACTS_TOO_MANY", admin_of("org-01"), "lifecycle", "approve", opened[1])
    deploy(chain, "late", VISITORS_2, delay=50)
    for _ in range(60):
        chain.block([])
    assert len(chain.view("lifecycle", "contracts")) == 64


def test_a_later_decision_about_a_contract_takes_the_place_of_one_that_waits(chain: Consortium) -> None:
    deploy(chain, "visitors", VISITORS, delay=30)
    deploy(chain, "visitors", VISITORS_2)
    chain.block([])
    assert chain.view("lifecycle", "changes_due") == []
    for _ in range(30):
        chain.block([])
    assert chain.view("lifecycle", "contract", "visitors")["version"] == 2
