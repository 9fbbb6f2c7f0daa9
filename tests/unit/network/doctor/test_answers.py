"""The doctor holds the nodes' words against one another and names what does not fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from network.doctor.answers import (
    Answer,
    check_clocks,
    check_finality,
    check_heights,
    check_late,
    check_links,
    check_membership,
    check_presence,
    check_roots,
    check_versions,
    check_words,
)
from network.doctor.examination import _check_answers
from network.doctor.findings import KINDS, Finding, in_order
from network.doctor.ledger_probe import LedgerFacts
from node.directory.node_directory import DirectoryContent, DirectoryNode, DirectoryOrganisation

VERSION = "0.1.0"


def answer(name: str, offset_ms: int = 0, **status: Any) -> Answer:
    fields = {"finalized_height": 10, "version": VERSION, "peers": [], "membership": "active"}
    return Answer(name, running=True, status=fields | status, offset_ms=offset_ms)


def directory(*names: str) -> DirectoryContent:
    nodes = {name: DirectoryNode(name, "hospital", "127.0.0.1", 1, "", b"", b"") for name in names}
    return DirectoryContent(3, nodes, {"hospital": DirectoryOrganisation("hospital", "")})


def codes(findings: list[Finding]) -> list[tuple[str, str]]:
    return [(finding.code, finding.node) for finding in findings]


def test_a_sound_network_gives_no_finding() -> None:
    answers = [answer("a", peers=["b"]), answer("b", peers=["a"])]
    for findings in (
        check_presence(answers),
        check_words(answers),
        check_links(answers, directory("a", "b")),
        check_clocks(answers, 5_000),
        check_heights(answers),
        check_versions(answers, VERSION),
        check_roots({"a": {9: "aa", 10: "bb"}, "b": {10: "bb"}}),
        check_finality(1_000_000, 1_050_000, 30_000, "on-demand", 500.0),
    ):
        assert findings == []


def test_a_sandbox_of_contracts_with_a_gap_is_named_but_not_a_missing_network_namespace() -> None:
    whole = {"sandbox": "on", "blocks": {"missing": {"network": "not permitted"}}}
    gap = {"sandbox": "on", "blocks": {"missing": {"system_calls": "the kernel refused", "network": "no"}}}
    answers = [answer("a", contracts=whole), answer("b", contracts=gap), answer("c", contracts={"sandbox": "off"})]
    found = check_words(answers)
    assert codes(found) == [("CONTRACT_SANDBOX_INCOMPLETE", "b"), ("CONTRACT_SANDBOX_INCOMPLETE", "c")]
    assert "system_calls (the kernel refused)." in found[0].detail


def test_dead_and_silent_nodes_are_told_apart_and_one_that_does_not_count_may_be_down() -> None:
    answers = [Answer("a", running=False, status=None, taken_ports=(7272,)), Answer("b", running=True, status=None)]
    assert codes(check_presence(answers)) == [("NODE_DOWN", "a"), ("PORT_TAKEN", "a"), ("NODE_SILENT", "b")]
    content = directory("a", "b")
    gone = replace(content, nodes={**content.nodes, "b": replace(content.nodes["b"], is_active=False)})
    assert codes(check_membership([answer(name) for name in "abc"], gone)) == [
        ("NODE_REMOVED", "b"),
        ("NODE_NOT_ADDED", "c"),
    ]
    answers = [Answer("b", running=False, status=None), Answer("c", running=False, status=None)]
    assert codes(check_presence(answers, frozenset({"b"}))) == [("NODE_DOWN", "c")]


def test_a_clock_a_version_or_a_height_is_named_only_beyond_what_is_tolerated() -> None:
    answers = [answer("a", 2_400), answer("b", 2_600), answer("c", -3_600_000)]
    found = check_clocks(answers, 5_000)
    assert codes(found) == [("CLOCK_SKEW", "b"), ("CLOCK_SKEW", "c")]
    assert "3600.0 s behind" in found[1].detail
    told = check_clocks([answer("a", finality={"clock_error_s": 600.2}), answer("b", 9_000, finality={})], 5_000)
    assert codes(told) == [("CLOCK_SKEW", "a"), ("CLOCK_SKEW", "b")]
    assert told[0].detail.endswith("this machine's clock is about 600 s ahead.")
    skewed = answer("a", -600_000, finality={"clock_error_s": -600.0})
    assert "behind this machine's" in check_clocks([skewed], 5_000)[0].detail, "the node's own clock, not the machine's"
    answers = [answer("a"), answer("b", version="0.2.0")]
    assert codes(check_versions(answers, VERSION)) == [("VERSION_DIFFERS", "b")]
    answers = [answer("a", finalized_height=100), answer("b", finalized_height=80), answer("c", finalized_height=2)]
    assert codes(check_heights(answers)) == [("NODE_BEHIND", "c")]


def test_what_nodes_say_of_themselves_and_of_peers_is_passed_on() -> None:
    refusal = {"peer": "c", "code": "PEER_CERTIFICATE_EXPIRED", "detail": "It expired."}
    answers = [
        answer("a", fault="The journal cannot be written.", refused_peers=[refusal]),
        answer(
            "b",
            lockout={"reason": "restored", "until": "later", "can_end": True},
            refused_peers=[refusal | {"peer": "d", "code": "PEER_REMOVED"}],
        ),
    ]
    assert codes(check_words(answers)) == [("NODE_FAULT", "a"), ("PEER_REFUSED", "c"), ("PRODUCER_LOCKED_OUT", "b")]


def test_a_lockout_is_waited_out_only_if_it_can_end() -> None:
    def found(reason: str, *, can_end: bool) -> Finding:
        [finding] = check_words([answer("b", lockout={"reason": reason, "until": "later", "can_end": can_end})])
        return finding

    assert found("restored", can_end=True).next_step.startswith("Wait:")
    lasting = found("restored", can_end=False)
    assert (lasting.code, lasting.kind.severity) == ("LOCKED_OUT_FOR_GOOD", "problem")
    assert "the data directory of b's last run" in lasting.next_step
    asking = found("asking", can_end=True)
    assert asking.code == "PRODUCER_ASKS"
    assert "backup" not in asking.kind.meaning


def test_of_up_to_three_producers_a_missing_one_is_said_to_stop_all() -> None:
    def told(names: list[str], quorum: int) -> str:
        answers = [answer("a", producers=names, quorum=quorum), Answer("b", running=False, status=None)]
        return check_presence(answers)[0].detail

    assert "Nothing becomes final without it" in told(["a", "b"], 2)
    assert "Nothing" not in told(["a", "b", "c", "d"], 3)
    assert "Nothing" not in told(["a", "c"], 2), "b is no producer"


def test_a_suspended_producer_is_named_with_the_command_that_brings_it_back() -> None:
    [found] = check_words([answer("a", suspended_height=None), answer("b", suspended_height=12)])
    assert (found.code, found.node, found.kind.severity) == ("PRODUCER_SUSPENDED", "b", "problem")
    assert "since height 12" in found.detail
    assert "blockrobot producer approve b --as ORG" in found.next_step


def test_a_removed_node_is_told_by_its_peers_and_makes_no_finality_stale() -> None:
    """One that did not run when it was removed never gets the block that says so."""
    late = {"late": True, "age_s": 121.0, "waiting_s": 0.0}
    refusals = [{"peer": "b", "code": "PEER_REMOVED", "detail": ""}]
    gone = answer("a", peers=[], finality=late, refused_by=refusals)
    assert codes(check_membership([gone], directory("a", "b"))) == [("NODE_REMOVED", "a")]
    ledgers = {"a": LedgerFacts("a", "", height=10, heartbeat_ms=30_000)}
    assert ("FINALITY_STALE", "") in codes(_check_answers([gone], ledgers, frozenset()))
    assert codes(_check_answers([gone], ledgers, frozenset({"a"}))) == []


def test_a_missing_link_is_named_once_unless_it_is_refused() -> None:
    answers = [answer("a", peers=["b"]), answer("b", peers=["a"]), answer("c")]
    assert codes(check_links(answers, directory("a", "b", "c"))) == [("LINK_MISSING", "a"), ("LINK_MISSING", "b")]
    assert check_links(answers, directory("a", "b")) == []
    refusal = {"peer": "c", "code": "PEER_REMOVED", "detail": ""}
    refusing = [answer(name, peers=peers, refused_peers=[refusal]) for name, peers in (("a", ["b"]), ("b", ["a"]))]
    assert check_links([*refusing, answer("c")], directory("a", "b", "c")) == []


def test_the_minority_of_a_divergence_is_named_and_where_nobody_is_all_are() -> None:
    three = {"a": {7: "x", 8: "y"}, "b": {7: "x", 8: "y"}, "c": {7: "x", 8: "z", 9: "w"}}
    assert codes(check_roots(three)) == [("STATE_DIVERGED", "c")]
    two = {"a": {8: "y"}, "b": {8: "z"}}
    assert codes(check_roots(two)) == [("STATE_DIVERGED", "a"), ("STATE_DIVERGED", "b")]


def test_finality_is_stale_after_several_heartbeats_or_at_once_if_nodes_say_so() -> None:
    assert codes(check_finality(0, 100_000, 30_000, "on-demand", 500.0)) == [("FINALITY_STALE", "")]
    assert check_finality(0, 100_000, 30_000, "on-demand", 20.0) == []
    assert check_finality(0, 100_000, 30_000, "manual", 500.0) == []
    well = {"finality": {"age_s": 24.0, "waiting_s": 0.0, "late": False}}
    late = {"finality": {"age_s": 24.0, "waiting_s": 20.4, "late": True}}
    assert check_late([Answer("node-1", True, well), Answer("node-2", False, None)]) == []
    (finding,) = check_late([Answer("node-1", True, late), Answer("node-2", True, well), Answer("node-3", True, late)])
    assert finding.code == "FINALITY_STALE"
    assert finding.detail == "No new final block for 24 s at node-1, node-3, and work has waited for 20 s."
    (finding,) = check_late([Answer("node-1", True, late | {"producers": ["node-1", "node-2"], "quorum": 2})])
    assert finding.detail.endswith("Of 2 producers 2 are needed.")


def test_each_kind_says_what_to_do_problems_come_first_and_the_how_to_lists_them() -> None:
    assert all(kind.next_step and kind.meaning for kind in KINDS.values())
    assert Finding("NODE_DOWN", "node-3", "").next_step.startswith("Start it: blockrobot node run node-3 --detach;")
    warning, problem = Finding("NODE_BEHIND", "a", "1"), Finding("NODE_DOWN", "b", "2")
    assert in_order([warning, problem, warning]) == [problem, warning]
    page = Path(__file__).resolve().parents[4] / "docs" / "how-to" / "when-something-is-wrong.md"
    text = page.read_text(encoding="utf-8")
    rows = [f"| `{kind.code}` | {kind.severity} | {kind.meaning} | {kind.next_step} |" for kind in KINDS.values()]
    assert [row for row in rows if row not in text] == []


def test_a_node_that_cannot_execute_what_others_could_is_named_with_the_block() -> None:
    sound = {"held": 1, "failures": 3, "last_failure": "it ended by signal 9", "stuck": None}
    stuck = sound | {"stuck": {"height": 12, "attempts": 4}}
    [found] = check_words([answer("a", execution=sound), answer("b", execution=stuck), answer("c")])
    assert (found.code, found.node) == ("BLOCK_NOT_EXECUTED", "b")
    assert "block 12 4 times: it ended by signal 9" in found.detail


def test_a_custodian_that_keeps_old_blocks_and_whoever_is_over_a_budget_are_named() -> None:
    kept = {"archive": False, "earliest_ms": 1, "held_by": None}
    held = answer("b", blocks_kept=kept | {"held_by": "custodian"}, earliest_height=5, custody_checkpoint=6)
    [found] = check_words([answer("a", blocks_kept=kept), held, answer("c", blocks_kept=kept | {"held_by": "record"})])
    assert (found.code, found.node) == ("OLD_BLOCKS_HELD", "b")
    assert found.detail == "It has blocks from 5 on; custody is at 6."
    row = {"peer": "peer b", "count": 3}
    (finding,) = check_words([answer("a", over_budget=[row])])
    assert (finding.code, finding.node) == ("OVER_BUDGET", "a")
    assert finding.detail == "At a, peer b is over its budget: it was refused or held up 3 times."
