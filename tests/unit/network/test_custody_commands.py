"""`blockrobot custody`: what custodians answer becomes a table, sentences with a next step, and an exit code."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from consensus.chain.genesis import genesis_from_json
from consensus.errors import BlockRobotError
from consensus.state.settings import UploadQuotas
from network.cli.main import main
from network.provisioning.network_layout import create_network
from node.custody.coordination.custody_answers import CustodyStatus, Progress, ScrubAnswer

ERASURE = "ab" * 32
LAST = "ef" * 16


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("custody-commands") / "network"
    create_network(folder, nodes=4, organisations=2, base_port=46_310)
    return folder


def _run(folder: Path, *arguments: str) -> Result:
    return CliRunner().invoke(main, ["custody", *arguments, "--dir", str(folder)])


def _answer(name: str, **changes: Any) -> CustodyStatus:
    answer = {
        "name": name,
        "member": name.encode().hex(),
        "checkpoint_height": 9,
        "finalized_height": 9,
        "behind_blocks": 0,
        "custodian": True,
        "failing": [],
        "serving": True,
        "busy": False,
        "clips_held": 7,
        "clips_staged": 1,
        "clips_missing": 0,
        "clips_erased": 2,
        "frames": 30,
        "shares": 0,
        "key_parts": 0,
        "outbox_ready": 0,
        "outbox_erasing": 0,
        "slots_used": 30,
        "slots_total": 4096,
        "store_bytes": 2_000_000,
        "waiting_for": {},
        "uploads": [_uploads()],
        "quotas": msgspec.structs.asdict(UploadQuotas()),
        "bytes_a_day": 5_000_000_000,
        "disk_free_bytes": 500_000_000_000,
        "disk_reserve_bytes": 1_073_741_824,
        "uploads_paused": False,
        "days_until_reserve": 99.8,
    }
    return msgspec.convert(answer | changes, CustodyStatus)


def _uploads(**changes: Any) -> dict[str, Any]:
    row = {
        "organisation": "hospital",
        "robot": "02" * 33,
        "staged_clips": 1,
        "staged_bytes": 200_000,
        "refused": 0,
        "refused_lately": {},
    }
    return row | {"held_clips": 7, "held_bytes": 1_400_000, "today_bytes": 0, "bytes_a_day": 5_000_000_000} | changes


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"uploads_paused": True, "disk_free_bytes": 1_000 << 20}, "takes no uploads: 1000 MiB are free, 1024 MiB are"),
        ({"days_until_reserve": 3.5}, "At 5.0 GB a day its disk reaches the reserve in 3.5 days."),
        (
            {"uploads": [_uploads(refused=9, refused_lately={"UPLOAD_QUOTA_EXCEEDED": 3, "VISIT_NOT_OPEN": 1})]},
            "hospital was refused uploads lately (UPLOAD_QUOTA_EXCEEDED 3, VISIT_NOT_OPEN 1), 9 since",
        ),
        ({"uploads": [_uploads(staged_clips=4_000)]}, "has used 98% of robot_staged_max_count"),
    ],
)
def test_uploads_that_are_too_many_are_named(
    says: dict[str, Any], folder: Path, changes: dict[str, Any], sentence: str
) -> None:
    says["node-2"] = _answer("node-2", **changes)
    result = _run(folder, "status")
    assert result.exit_code == 1
    assert sentence in " ".join(result.stdout.split())


@pytest.fixture
def says(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What each custodian says: an answer, or what it refuses with."""
    said: dict[str, Any] = {name: _answer(name) for name in ("node-1", "node-2")}

    async def ask_all(configs: list[Any]) -> list[Any]:
        return [said[config.name] for config in configs]

    async def run_work(config: Any, kind: type[Any], on_progress: Any, *, after: bytes) -> Any:
        on_progress(config.name, Progress(what="records", done=1, total=2, last=LAST if kind is ScrubAnswer else ""))
        on_progress(config.name, Progress(what="keys", done=0, total=0))
        said["after"] = after
        report = said[f"{'scrub' if kind is ScrubAnswer else 'rebuild'} {config.name}"]
        if isinstance(report, BlockRobotError):
            raise report
        return msgspec.convert(report, kind)

    monkeypatch.setattr("network.cli.custody.custody_commands.ask_all", ask_all)
    monkeypatch.setattr("network.cli.custody.custody_commands.run_work", run_work)
    return said


def test_custodians_that_are_well_are_shown_in_a_table_and_exit_0(folder: Path, says: dict[str, Any]) -> None:
    result = _run(folder, "status")
    assert result.exit_code == 0, result.output
    for text in ("node-1", "node-2", "up to date", "30", "2.0 MB"):
        assert text in result.stdout
    answer = json.loads(_run(folder, "status", "--json").stdout)
    assert answer["ok"]
    assert [row["clips_held"] for row in answer["custodians"]] == [7, 7]


def test_what_is_behind_missing_and_overdue_is_said_with_a_next_step(folder: Path, says: dict[str, Any]) -> None:
    overdue = {"receipts": 1, "overdue": [{"erasure_id": ERASURE, "age_s": 900, "records": 3}]}
    late = _answer("node-2").member
    says["node-1"] = _answer("node-1", waiting_for={late: overdue}, clips_missing=4)
    says["node-2"] = _answer("node-2", behind_blocks=120, waiting_for={late: overdue})
    result = _run(folder, "status")
    assert result.exit_code == 1
    assert "120 blocks behind" in result.stdout
    assert "node-1 lacks 4 clips" in result.stdout
    assert result.stdout.count("node-2 has not confirmed the erasure abababababababab") == 1
    assert "900 s ago. Next step" in result.stdout


def test_one_that_was_removed_is_not_called_up_to_date(folder: Path, says: dict[str, Any]) -> None:
    says["node-2"] = _answer("node-2", custodian=False)
    result = _run(folder, "status")
    assert result.exit_code == 1
    assert "node-2 is no custodian of the chain and takes no uploads. Next step" in " ".join(result.stdout.split())
    assert result.stdout.count("up to date") == 1


def test_a_disk_that_lasts_for_ages_is_not_told_in_days(folder: Path, says: dict[str, Any]) -> None:
    says["node-2"] = _answer("node-2", days_until_reserve=250_594.8)
    told = " ".join(_run(folder, "status").stdout.split())
    assert "which last 99.8 days at 5.00 GB a day" in told
    assert "which last more than ten years at" in told


def test_a_store_that_does_not_answer_is_named_and_not_called_catching_up(folder: Path, says: dict[str, Any]) -> None:
    failing = {"work": "following", "code": "STORE_UNAVAILABLE", "detail": "No server.", "failing_s": 75}
    says["node-2"] = _answer("node-2", behind_blocks=120, failing=[failing])
    result = _run(folder, "status")
    assert result.exit_code == 1
    assert "node-2: It has not been able to follow the chain for 75 s: No server (STORE_UNAVAILABLE)." in result.stdout
    assert "Next step: See that the server of the store" in result.stdout
    assert "look again soon" not in result.stdout
    assert "failing" in result.stdout


def test_an_erasure_that_a_silent_custodian_owes_is_told_by_the_other(folder: Path, says: dict[str, Any]) -> None:
    key = json.loads((folder / "genesis.json").read_text())["nodes"][1]["custodian_key"]
    overdue = {"receipts": 1, "overdue": [{"erasure_id": ERASURE, "age_s": 900, "records": 3}]}
    says["node-1"] = _answer("node-1", waiting_for={key: overdue})
    says["node-2"] = BlockRobotError("NODE_UNREACHABLE", "node-2 does not answer.")
    result = _run(folder, "status")
    assert result.exit_code == 1
    assert "no answer" in result.stdout
    assert "node-2 has not confirmed the erasure" in result.stdout


def _scrubbed(**changes: Any) -> dict[str, Any]:
    lists = ("missing", "held_though_erased", "unknown_to_chain", "other_facts", "unclaimed_frames", "unclaimed_keys")
    pairs = ("frames_held_though_erased", "corrupted", "parts_held_though_ended", "empty_frames_held_though_withdrawn")
    report: dict[str, Any] = {name: [] for name in (*lists, *pairs)}
    counts = {"height": 9, "after": "", "records_count": 7, "clips_compared_count": 7, "frames_compared_count": 30}
    files = {"dirty_slots_count": 0, "log_bytes": 0, "dirty_bytes": 0}
    return {"ok": True, "nothing_erased_is_left": True, **report, **counts, **files, **changes}


def test_a_clean_scrub_says_so_and_exits_0(folder: Path, says: dict[str, Any]) -> None:
    says |= {"scrub node-1": _scrubbed(), "scrub node-2": _scrubbed(dirty_bytes=None, log_bytes=None)}
    result = _run(folder, "scrub")
    assert result.exit_code == 0, result.output
    assert result.stdout.count("no ciphertext and no key is left here") == 2
    assert result.stdout.count("database's server cannot be looked into") == 1


@pytest.mark.parametrize(
    ("finding", "told"),
    [
        ({"held_though_erased": ["aa" * 16]}, "erased them: " + "aa" * 16 + ". Next step"),
        ({"corrupted": [{"record": "bb" * 16, "frame": 3}]}, "bb" * 16 + " frame 3"),
        ({"missing": ["cc" * 16] * 5}, "5 records are missing"),
        (
            {"empty_frames_held_though_withdrawn": ["dd" * 32]},
            "1 empty frames are held that are approved no more: dddd",
        ),
        ({"unclaimed_keys": [4, 5]}, "2 erase keys belong to no frame"),
        ({"dirty_slots_count": 1}, "restart node-1"),
        ({"dirty_bytes": 4096}, "free pages 4096"),
    ],
)
def test_what_a_scrub_finds_is_said_and_exits_1(
    folder: Path, says: dict[str, Any], finding: dict[str, Any], told: str
) -> None:
    says["scrub node-1"] = _scrubbed(ok=False, nothing_erased_is_left=False, **finding)
    result = _run(folder, "scrub", "node-1")
    assert result.exit_code == 1
    assert told in result.stdout
    assert "no key is left" not in result.stdout
    assert json.loads(_run(folder, "scrub", "node-1", "--json").stdout)["ok"] is False


def test_a_rebuild_says_what_it_did_and_what_is_still_to_be_had(folder: Path, says: dict[str, Any]) -> None:
    lists = {name: ["aa" * 16] for name in ("erased_again", "corrected", "forgotten", "mended", "still_damaged")}
    done = {"ok": False, "height": 9, "clips_count": 7, "keys_destroyed_count": 1, "fetched_count": 5}
    says["rebuild node-2"] = {**done, **lists, "unknown_to_chain": ["bb" * 16], "still_missing_count": 2}
    result = _run(folder, "rebuild", "node-2")
    assert result.exit_code == 1
    for text in ("1 records erased again", "5 clips fetched", "2 clips are still missing", "1 clips are still damaged"):
        assert text in result.stdout
    assert "nothing else" not in result.stdout


@pytest.mark.parametrize(
    ("code", "exit_code"), [("CUSTODY_CATCHING_UP", 1), ("OPERATOR_TOKEN_INVALID", 4), ("NODE_UNREACHABLE", 1)]
)
def test_a_custodian_that_refuses_is_told_by_code_and_exit_code(
    folder: Path, says: dict[str, Any], code: str, exit_code: int
) -> None:
    says["scrub node-1"] = BlockRobotError(code)
    result = _run(folder, "scrub", "node-1", "--json")
    assert result.exit_code == exit_code
    assert json.loads(result.stdout)["error"]["code"] == code


def test_a_scrub_that_broke_off_says_how_to_go_on_and_goes_on_there(folder: Path, says: dict[str, Any]) -> None:
    says["scrub node-1"] = _scrubbed()
    says["scrub node-2"] = BlockRobotError("NODE_UNREACHABLE")
    broken = _run(folder, "scrub")
    assert broken.exit_code == 1
    assert f"blockrobot custody scrub {folder / 'nodes' / 'node-2'} --after {LAST}" in broken.stderr
    says["scrub node-2"] = _scrubbed(after=LAST)
    result = _run(folder, "scrub", "node-2", "--after", LAST)
    assert result.exit_code == 0, result.output
    assert says["after"].hex() == LAST
    said = " ".join(result.stdout.split())
    assert f"looked up after {LAST}" in said
    assert f"Of what was erased among the records after {LAST}, no ciphertext" in said


@pytest.mark.parametrize("arguments", [("--after", LAST), ("node-2", "--after", LAST[:-1])])
def test_a_scrub_goes_on_at_one_node_after_a_record(folder: Path, arguments: tuple[str, ...]) -> None:
    assert _run(folder, "scrub", *arguments).exit_code == 2


def test_a_custodian_that_is_none_is_refused_and_a_network_that_is_down_is_said_to_be(folder: Path) -> None:
    for name, exit_code, code in (("node-4", 3, "CUSTODY_ELSEWHERE"), ("node-9", 3, "NOT_FOUND")):
        result = _run(folder, "status", name, "--json")
        assert (result.exit_code, json.loads(result.stdout)["error"]["code"]) == (exit_code, code)
    result = _run(folder, "status", "--json")
    assert result.exit_code == 1
    assert [row["error"] for row in json.loads(result.stdout)["custodians"]] == ["NODE_UNREACHABLE"] * 2


def test_custodians_are_asked_from_outside_by_their_genesis_file(folder: Path) -> None:
    genesis = folder / "genesis.json"
    said = CliRunner().invoke(main, ["custody", "status", "--genesis", str(genesis), "--json"])
    answer = json.loads(said.stdout)
    assert (said.exit_code, answer["ok"], answer["custodians"]) == (1, False, []), "none of them runs"
    keeping = [node.name for node in genesis_from_json(genesis.read_bytes()).custodians]
    assert [other["name"] for other in answer["elsewhere"]] == keeping
    assert CliRunner().invoke(main, ["custody", "status", "node-1", "--genesis", str(genesis)]).exit_code == 2
