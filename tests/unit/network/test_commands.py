"""The command line: help everywhere, plain refusals, one JSON object, exit codes that programs can rely on."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result
from nacl import pwhash

from clients.sdk.passphrase import PassphraseCost
from clients.wallet.store.keystore import Keystore
from consensus.errors import CATALOGUE
from network.cli.main import main
from network.provisioning.network_layout import create_network

WORDS = "abandon " * 23 + "art"
CHEAP = PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN)


def every_command() -> Iterator[tuple[tuple[str, ...], click.Command]]:
    def walk(command: click.Command, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], click.Command]]:
        yield path, command
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                child = command.get_command(context, name)
                assert child is not None
                yield from walk(child, (*path, name))

    return walk(main, ())


COMMANDS = dict(every_command())


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.delenv("BLOCKROBOT_PASSPHRASE_FILE", raising=False)
    return tmp_path


@pytest.fixture
def network(home: Path) -> Path:
    create_network(home / "network", nodes=1, organisations=1, base_port=46_780)
    return home / "network"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, list(arguments))


def problem_of(result: Result) -> dict[str, Any]:
    """Return the error of a JSON answer, checked for its form."""
    answer = json.loads(result.stdout)
    assert answer["ok"] is False
    problem: dict[str, Any] = answer["error"]
    assert problem["code"] in CATALOGUE
    assert problem["next_step"] == CATALOGUE[problem["code"]].next_step
    return problem


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: " ".join(path) or "blockrobot")
def test_every_command_explains_itself(path: tuple[str, ...], home: Path) -> None:
    result = run(*path, "--help")
    assert result.exit_code == 0
    assert "Usage:" in result.output
    assert (COMMANDS[path].help or "").strip().split("\n")[0].endswith((".", ":", "?", "gone,")) or path == ()


def test_every_command_can_answer_in_json_and_those_of_the_root_show_an_example() -> None:
    silent = [
        " ".join(path)
        for path, command in COMMANDS.items()
        if not isinstance(command, click.Group) and "as_json" not in {parameter.name for parameter in command.params}
    ]
    assert silent == []
    without = [
        path[0] for path, command in COMMANDS.items() if len(path) == 1 and "Example" not in (command.help or "")
    ]
    assert without == []


def test_wrong_usage_without_json_is_for_people(network: Path) -> None:
    assert run("conquer").exit_code == 2
    for arguments in (("conquer",), ("up", "--nodes", "99"), ("contract", "call", "--", "--json")):
        result = run(*arguments)
        assert (result.exit_code, result.stdout) == (2, "")
        assert "Usage: " in result.stderr


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("conquer", "--json"), "conquer"),
        (("--json", "status"), "--json"),
        (("contract", "call", "--json"), "CONTRACT"),
        (("contract", "trace", "--json", "not-an-id"), "64"),
        (("up", "--nodes", "99", "--json"), "--nodes"),
        (("logs", "--lines", "many", "--json"), "--lines"),
        (("sim", "run", "--json", "--unheard-of"), "--unheard-of"),
        (("wallet", "erase", "--json"), "--all"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_wrong_usage_is_told_in_json_too(network: Path, arguments: tuple[str, ...], named: str) -> None:
    result = run(*arguments)
    assert (result.exit_code, result.stderr) == (2, "")
    problem = problem_of(result)
    assert problem["code"] == "USAGE_INVALID"
    assert named in problem["detail"]


def test_a_host_with_a_genesis_file_and_no_node_looks_from_outside_and_is_not_told_to_start_one(
    network: Path, home: Path
) -> None:
    client = home / "client" / "network"
    client.mkdir(parents=True)
    genesis = client / "genesis.json"
    genesis.write_bytes((network / "genesis.json").read_bytes())
    for words in (("--dir", str(client)), ("--genesis", str(genesis))):
        told = run("status", *words)
        assert told.exit_code == 0
        assert "No node of the network is in" in told.stdout
        assert "Elsewhere, as they prove" in told.stdout
        assert "Nothing runs" not in told.stdout
        answer = json.loads(run("status", *words, "--json").stdout)
        assert (answer["ok"], answer["nodes"]) == (False, [])
        assert [node["problem"]["code"] for node in answer["elsewhere"]] == ["NODE_UNREACHABLE"]
        assert "node run NAME --detach" in answer["elsewhere"][0]["problem"]["next_step"]
    answer = json.loads(run("custody", "status", "--dir", str(client), "--json").stdout)
    assert (answer["custodians"], [node["name"] for node in answer["elsewhere"]]) == ([], ["node-1"])
    assert run("status", "--watch", "--dir", str(client)).exit_code == 2
    assert run("status", "--watch", "--genesis", str(genesis)).exit_code == 2


def test_a_host_whose_network_is_not_founded_yet_is_told_what_to_adopt(network: Path) -> None:
    (network / "genesis.json").unlink()
    own = network / "nodes" / "node-1" / "genesis.json"
    assert f"cp {own} {network}" in problem_of(run("status", "--json"))["detail"]
    for path in network.glob("nodes/*/genesis.json"):
        path.unlink()
    assert "genesis check FILE --adopt" in problem_of(run("status", "--json"))["next_step"]


@pytest.mark.parametrize("command", [("status",), ("down",), ("logs",)])
def test_where_there_is_no_network_that_is_said(home: Path, command: tuple[str, ...]) -> None:
    result = run(*command, "--json")
    assert result.exit_code == 1
    assert problem_of(result)["code"] == "CLUSTER_NOT_RUNNING"
    spoken = run(*command)
    assert "CLUSTER_NOT_RUNNING" in spoken.stderr
    assert "Next step" in spoken.stderr
    assert "Traceback" not in spoken.output


def test_a_stopped_network_names_its_nodes_as_stopped_and_may_be_stopped_again(network: Path) -> None:
    answer = json.loads(run("status", "--json").stdout)
    assert (answer["ok"], answer["nodes"]) == (False, [{"name": "node-1", "running": False}])
    assert "stopped" in run("status").output
    assert json.loads(run("down", "--json").stdout) == {"ok": True, "stopped": []}


def test_logs_show_the_last_lines_and_a_node_that_is_not_there_is_not_found(network: Path) -> None:
    (network / "nodes" / "node-1" / "node.log").write_text("one\ntwo\nthree\n", encoding="utf-8")
    assert run("logs", "--lines", "2").output == "node-1 two\nnode-1 three\n"
    answer = json.loads(run("logs", "--lines", "1", "--json").stdout)
    assert answer == {"ok": True, "lines": [{"node": "node-1", "line": "three"}]}
    result = run("logs", "node-7", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (3, "NOT_FOUND")


def passphrase(home: Path, text: str) -> None:
    (home / "passphrase").write_text(text + "\n", encoding="utf-8")
    os.environ["BLOCKROBOT_PASSPHRASE_FILE"] = str(home / "passphrase")


@pytest.fixture
def wallet(network: Path, home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", "")
    passphrase(home, "tea and lemon cake")
    path = home / "wallets" / "default.wallet"
    Keystore.create(path, WORDS, "tea and lemon cake", CHEAP)
    return path


def test_wallet_commands_that_cannot_go_on_say_why_in_code_and_exit_code(
    wallet: Path, home: Path, network: Path
) -> None:
    result = run("wallet", "--profile", "bob", "records", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (3, "WALLET_NOT_FOUND")
    result = run("wallet", "records", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (1, "NODE_UNREACHABLE")
    result = run("wallet", "new", "--words-file", str(home / "words"), "--fast-passphrase", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (1, "WALLET_EXISTS")
    result = run("wallet", "register", "BR1-AAAA", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (1, "VOUCHER_INVALID")
    passphrase(home, "coffee")
    result = run("wallet", "records", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (4, "WALLET_PASSPHRASE_WRONG")
    (network / "genesis.json").unlink()
    result = run("wallet", "records", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (1, "GENESIS_INVALID")


@pytest.mark.parametrize(
    "arguments",
    [
        ("wallet", "new"),
        ("wallet", "restore"),
        ("wallet", "erase", "--all"),
        ("wallet", "erase"),
        ("wallet", "--profile", "../x", "records"),
        ("card", "issue"),
        ("roster", "make", "--robot", "zz", "--out", "r"),
    ],
    ids=" ".join,
)
def test_without_a_terminal_nothing_asks_and_nothing_hangs(network: Path, arguments: tuple[str, ...]) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert "Error:" in result.stderr


def test_a_new_wallet_writes_its_words_where_told_and_shows_no_secret(network: Path, home: Path, wallet: Path) -> None:
    words = home / "words"
    result = run("wallet", "--profile", "ann", "new", "--words-file", str(words), "--fast-passphrase", "--json")
    answer = json.loads(result.stdout)
    assert answer["ok"]
    assert words.stat().st_mode & 0o777 == 0o600
    assert all(word not in result.output.split() for word in words.read_text(encoding="utf-8").split())
    assert "tea and lemon cake" not in result.output
    restored = run("wallet", "--profile", "again", "restore", "--words-file", str(words), "--fast-passphrase", "--json")
    assert json.loads(restored.stdout)["member"] == answer["member"]


def test_a_card_is_issued_from_a_file_and_its_uid_is_not_repeated(network: Path, home: Path) -> None:
    (home / "uid").write_text("E28011606000\n", encoding="utf-8")
    result = run("card", "issue", "--uid-file", str(home / "uid"), "--json")
    answer = json.loads(result.stdout)
    assert (answer["ok"], answer["role"]) == (True, "subject")
    assert answer["code"].startswith("BR1-")
    assert "E28011606000" not in result.output
    again = run("card", "issue", "--uid-file", str(home / "uid"), "--json")
    assert (answer["replaced"], json.loads(again.stdout)["replaced"]) == (False, True)
    plain = run("card", "issue", "--uid-file", str(home / "uid"))
    assert "Whoever registered with that one is on no roster from now on" in plain.output
    assert "destroy that card" in plain.output


def test_a_robot_gets_its_keys_once(home: Path) -> None:
    first = json.loads(run("robot", "new", "--json").stdout)
    assert len(bytes.fromhex(first["member"])) == 33
    result = run("robot", "new", "--json")
    assert (result.exit_code, problem_of(result)["code"]) == (1, "ROBOT_EXISTS")


def test_the_reference_pages_tell_when_they_are_stale(home: Path) -> None:
    out = str(home / "pages")
    assert run("reference", "--out", out, "--check", "--json").exit_code == 1
    changed = json.loads(run("reference", "--out", out, "--json").stdout)["changed"]
    of_nodes = {"http-api.md", "errors.md", "authorisation.md", "state.md"}
    assert set(changed) == {*of_nodes, "json-output.md", "json-output.schema.json"}
    assert json.loads(run("reference", "--out", out, "--check", "--json").stdout)["ok"]
