"""The page of what commands answer with --json: no command is missing on it, and it says what the commands say."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from clients.sdk.terminal import terminal
from network.cli.cluster.status_watch import picture_answer
from network.cli.json_reference import (
    NOT_LISTED,
    PAGE,
    SCHEMA,
    SECTIONS,
    listed_answers,
    write_json_page,
    write_json_schema,
)
from network.cluster_monitor import NodeObservation, Observer, changes
from tests.json_answers import answers_of_processes, differences, is_elsewhere, leaves, noted_differences, read_noted

FOLDER = Path(__file__).parents[3] / "docs" / "reference"
REFUSED_RECEIPT = {"txid": "ab", "height": 3, "from_height": 4, "count": 1, "status": "withdrawn", "purposes": []}
FOR_ONESELF = {"sensors": [], "for": None, "mandate_id": None}
WITHDRAWN = {"ok": True, **REFUSED_RECEIPT, **FOR_ONESELF, "receipt": None, "receipt_error": "NODE_UNREACHABLE"}


def test_the_page_is_current_and_has_every_command_and_field_once() -> None:
    assert (FOLDER / PAGE).read_text(encoding="utf-8") == write_json_page(), "run: blockrobot reference"
    assert (FOLDER / SCHEMA).read_text(encoding="utf-8") == write_json_schema(), "run: blockrobot reference"
    speaking = {words for words, command in leaves() if any("--json" in each.opts for each in command.params)}
    elsewhere = {words for words in speaking if is_elsewhere(words)}
    listed = {words for words in listed_answers() if " --" not in words}
    assert speaking - elsewhere == listed
    assert not listed & elsewhere
    assert all(any(f"{words} ".startswith(f"{group} ") for words in elsewhere) for group in NOT_LISTED)
    people = {words for words, _ in leaves() if words.split()[0] in {"wallet", "officer", "verify", "robot", "fault"}}
    assert len(people) > 60
    assert people <= set(listed_answers())
    named = [words for answers in SECTIONS.values() for words in answers]
    assert sorted(named) == sorted(set(named))
    assert [name for name in json.loads(write_json_schema())["$defs"] if "." in name] == []
    for name, kind in json.loads(write_json_schema())["$defs"].items():
        assert kind["description"], name
        assert [field for field, schema in kind["properties"].items() if not schema.get("description")] == [], name


def test_when_a_field_is_null_or_absent_is_said_of_it() -> None:
    """Of a node's status the type says it for all fields at once."""
    for name, kind in json.loads(write_json_schema())["$defs"].items():
        fields = kind["properties"].items()
        optional = {field: schema for field, schema in fields if field not in kind.get("required", ())}
        nullable = [field for field, schema in fields if {"type": "null"} in schema.get("anyOf", ())]
        assert [field for field in nullable if "null" not in kind["properties"][field]["description"]] == [], name
        if name != "NodeStatus":
            assert [field for field, schema in optional.items() if "absent" not in schema["description"]] == [], name


def test_an_answer_is_as_documented_or_found_out() -> None:
    assert differences("wallet consent withdraw", WITHDRAWN) == []
    told = {name: value for name, value in WITHDRAWN.items() if name != "height"}
    assert differences("wallet consent withdraw", told) == [
        "wallet consent withdraw: Object missing required field `height`"
    ]
    assert differences("wallet fly", {"ok": True}) == ["wallet fly: it is not documented"]
    assert differences("", {"ok": True}) == ["a command without a name: it is not documented"]
    assert differences("custody status", {"whatever": 1}) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"more": 1}, "it has other fields than ConsentWordAnswer"),
        ({"count": None}, "Expected `int`, got `null` - at `$.count`"),
        ({"count": "1"}, "Expected `int`, got `str` - at `$.count`"),
        ({"txid": "xy"}, "Expected `str` matching regex '^([0-9a-f]{2})*$' - at `$.txid`"),
        ({"ok": False}, "ok is False, which is not documented"),
        ({"ok": None}, "ok is None, which is not documented"),
        ({"receipt": {"signed_by": "node-1"}}, "Object missing required field `notice_version` - at `$.receipt`"),
    ],
)
def test_an_answer_that_is_otherwise_is_found_out(change: dict[str, object], said: str) -> None:
    (line,) = differences("wallet consent withdraw", WITHDRAWN | change)
    assert line.startswith(f"wallet consent withdraw: {said}")


def test_a_command_gives_one_of_its_answers_and_is_not_ok_only_where_that_is_documented() -> None:
    network = {"network": "ward", "chain_id": "ab", "genesis_id": "cd", "is_anchored": True}
    told = {"ok": True, "file": "mine.zip", **network, "consent_receipts": 0, "signed_consent_receipts": []}
    assert differences("verify", told) == []
    assert differences("verify", told | {"visits": 1}), "a bundle has more"
    assert json.loads(write_json_schema())["commands"]["verify"].keys() == {"anyOf"}
    told = {"ok": False, "unfinished": [], "not_begun": True}
    assert differences("wallet serve", told) == []


def test_answers_are_held_against_the_page_also_after_a_test_has_undone_its_patches(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    noting = terminal.write_json
    monkeypatch.undo()
    assert terminal.write_json is noting
    assert noting.__module__ == "tests.conftest"


def test_a_line_of_the_watcher_is_as_documented_whether_a_node_answers_or_not() -> None:
    status = {"height": 5, "finalized_height": 3, "round": 9, "epoch": 0, "leader": "node-1", "peers": ["node-2"]}
    looks = [
        NodeObservation("node-1", running=True, paused=False, status={**status, "mempool": 2, "ready": True}),
        NodeObservation("node-2", running=False, paused=False, status=None, faults=("journal disk full",)),
    ]
    picture = Observer(0.0).update(looks, 1.5)
    assert differences("status --watch", msgspec.to_builtins(picture_answer(picture, changes(None, picture)))) == []


def test_what_a_process_of_its_own_answers_is_noted_and_held_against_the_page(tmp_path: Path) -> None:
    file = tmp_path / "answers.jsonl"
    command = [sys.executable, "-m", "network.cli.main", "robot", "--robot-dir", str(tmp_path), "new", "--json"]
    with answers_of_processes(file):
        printed = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert read_noted(file) == [("robot new", printed)]
    assert noted_differences(file) == []
    file.write_text(json.dumps({"words": "robot new", "told": {"ok": True, "folder": "robots"}}) + "\n")
    assert noted_differences(file) == ["robot new: Object missing required field `sealed`"]
