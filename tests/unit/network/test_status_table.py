"""`blockrobot status` does not call a network well in which nothing becomes final, nor a producer that may not lead."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from network.cli.cluster.cluster_commands import report
from network.cluster import NodeStatusReport
from network.provisioning.network_layout import create_network
from node.config import load_config
from node.node_process import Node
from pages.time_format import format_time
from tests.cluster.network_under_test import find_base_port


def said(capsys: pytest.CaptureFixture[str], *, as_json: bool = False, **status: Any) -> str:
    usual = {
        "ready": True,
        "height": 9,
        "finalized_height": 8,
        "round": 12,
        "leader": "node-2",
        "peers": ["node-2"],
        "mempool": 0,
        "custody_checkpoint": None,
        "lockout": None,
        "finality": {"age_s": 3.4, "waiting_s": 0.0, "late": False, "clock_error_s": 0.0},
        "suspended_height": None,
    }
    row = NodeStatusReport("node-1", running=True, status=usual | status)
    report([row], Path("network"), as_json=as_json)
    return capsys.readouterr().out


def test_a_node_at_work_is_ready_and_its_newest_final_block_has_an_age(capsys: pytest.CaptureFixture[str]) -> None:
    text = said(capsys)
    assert "ready" in text
    assert "Newest final block: 8, 3 s ago." in text
    assert "no new final block" not in text
    assert "suspended" not in text


def test_a_custodian_that_cannot_work_is_named_with_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    assert "custodian" not in said(capsys)
    told = said(capsys, custody_checkpoint=7, custody_failing="STORE_UNAVAILABLE")
    assert "node-1's custodian cannot work (STORE_UNAVAILABLE): see blockrobot custody status node-1" in told


def test_a_stuck_network_is_not_called_ready(capsys: pytest.CaptureFixture[str]) -> None:
    late = {"age_s": 45.2, "waiting_s": 44.0, "late": True, "clock_error_s": 0.0}
    text = said(capsys, finality=late, mempool=3)
    assert "stuck" in text
    assert "ready" not in text
    assert "node-1 has had no new final block for 45 s, and transactions wait (3)." in text
    assert "wait" not in said(capsys, finality=late).splitlines()[-1]
    assert json.loads(said(capsys, as_json=True, finality=late))["nodes"][0]["finality"] == late


def test_a_node_whose_machine_has_a_wrong_clock_is_not_called_ready(capsys: pytest.CaptureFixture[str]) -> None:
    text = said(capsys, finality={"age_s": 1.0, "waiting_s": 0.0, "late": False, "clock_error_s": 600.2})
    assert "ready" not in text
    assert "this machine's clock is about 600 s ahead. Set the clock (NTP, chrony)" in text


def test_a_refused_peer_is_told_with_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    row = {"peer": "node-3", "code": "GENESIS_DIFFERS", "detail": "Another chain.", "next_step": "Compare."}
    assert "node-1 refuses node-3: GENESIS_DIFFERS. Another chain. Compare." in said(capsys, refused_peers=[row])
    assert "refuses" not in said(capsys, refused_peers=[row | {"code": "PEER_REMOVED"}])


REMOVED = [{"peer": name, "code": "PEER_REMOVED", "detail": "It was."} for name in ("node-2", "node-3")]


@pytest.mark.parametrize(
    ("status", "sentence"),
    [
        (
            {"problem": {"code": "NODE_REMOVED", "detail": "node-1 was removed.", "next_step": "Stop it."}},
            "node-1 was removed. (NODE_REMOVED) Stop it",
        ),
        ({"refused_by": REMOVED}, "node-2, node-3 say that node-1 was removed. (NODE_REMOVED)"),
    ],
)
def test_a_removed_node_says_so_and_not_that_blocks_are_late(
    capsys: pytest.CaptureFixture[str], status: dict[str, Any], sentence: str
) -> None:
    late = {"age_s": 121.0, "waiting_s": 0.0, "late": True, "clock_error_s": 0.0}
    text = said(capsys, ready=False, peers=[], finality=late, **status)
    (row,) = [line for line in text.splitlines() if line.startswith("│node-1")]
    assert ("removed" in row, "waiting" in row) == (True, False)
    assert sentence in text
    assert "no new final block" not in text


def test_one_peer_that_calls_a_node_removed_is_not_believed_while_others_talk_to_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert "removed" not in said(capsys, refused_by=REMOVED[:1])


def test_what_keeps_all_peers_from_a_node_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    problem = {"code": "CERTIFICATE_EXPIRED", "detail": "It is over.", "next_step": "Renew it."}
    assert "node-1: It is over. (CERTIFICATE_EXPIRED) Renew it." in said(capsys, problem=problem)


def test_a_lockout_that_cannot_end_is_told_with_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    lockout = {"reason": "restored", "until": "later", "can_end": True}
    assert "Waiting does not help" not in said(capsys, lockout=lockout)
    text = said(capsys, lockout=lockout | {"can_end": False})
    assert "locked out" in text
    assert "Waiting does not help" in text


def test_a_suspended_producer_is_told_with_the_way_back(capsys: pytest.CaptureFixture[str]) -> None:
    text = said(capsys, suspended_height=7)
    assert "ready" not in text
    assert "node-1 is suspended since height 7 and leads nothing" in text
    assert "blockrobot producer approve node-1 --as ORG" in text
    assert json.loads(said(capsys, as_json=True, suspended_height=7))["nodes"][0]["suspended_height"] == 7


def test_a_node_of_an_earlier_version_says_less_and_is_shown_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    report([NodeStatusReport("node-1", running=True, status={"ready": True})], Path("network"), as_json=False)
    assert "ready" in capsys.readouterr().out


async def test_all_that_a_node_says_is_told_to_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    create_network(tmp_path, nodes=1, organisations=1, base_port=find_base_port(3))
    config = load_config(tmp_path / "nodes" / "node-1")
    async with Node(config) as node:
        status = json.loads(json.dumps(node.describe()))
    capsys.readouterr()  # the node's log
    report([NodeStatusReport("node-1", running=True, status=status)], tmp_path, as_json=True)
    assert json.loads(capsys.readouterr().out)["nodes"] == [{"running": True, **status}]
    assert len(status) > 30


def test_what_a_node_of_another_version_says_in_another_form_is_left_out_and_named_for_programs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    execution = {"held": 0, "failures": 0, "last_failure": "", "stuck": None}
    more = execution | {"mended": 1}
    answer = json.loads(said(capsys, as_json=True, height="nine", finality={"age": 3}, mood="good", execution=more))
    node = answer["nodes"][0]
    assert (answer["ok"], node["name"], node["finalized_height"]) == (True, "node-1", 8)
    assert not {"height", "finality", "mood"} & node.keys()
    assert node["execution"] == execution
    assert sorted(node["unread"]) == ["execution", "finality", "height", "mood"]


def test_a_node_cannot_name_itself_otherwise_or_say_for_itself_what_was_not_read(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = said(capsys, as_json=True, name="node-2", running="no", unread=["leader"], height="nine")
    (node,) = json.loads(text)["nodes"]
    assert (node["name"], node["running"], node["unread"]) == ("node-1", True, ["height"])


def test_how_far_back_nodes_keep_blocks_is_told_of_those_that_keep_the_same_at_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    kept = {"archive": False, "earliest_ms": 1_700_000_000_000, "held_by": None}
    rows = [
        NodeStatusReport("node-1", running=True, status={"earliest_height": 7, "blocks_kept": kept}),
        NodeStatusReport("node-2", running=True, status={"earliest_height": 7, "blocks_kept": kept}),
        NodeStatusReport(
            "node-3", running=True, status={"earliest_height": 0, "blocks_kept": kept | {"archive": True}}
        ),
        NodeStatusReport(
            "node-4", running=True, status={"earliest_height": 5, "blocks_kept": kept | {"held_by": "custodian"}}
        ),
        NodeStatusReport("node-5", running=False, status=None),
        NodeStatusReport("node-6", running=True, status={"earliest_height": 0, "blocks_kept": kept}),
    ]
    report(rows, Path("network"), as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert f"node-1, node-2: the oldest block kept is 7 ({format_time(1_700_000_000_000)})." in lines
    assert f"node-3: the oldest block kept is 0 ({format_time(1_700_000_000_000)}), as an archive." in lines
    assert any(
        line.startswith("node-4: the oldest block kept is 5 ") and "custodian has not followed" in line
        for line in lines
    )
    assert not any(line.startswith("node-6: ") for line in lines)
