"""The example for Docker, which cannot be run here: it is whole, and names commands and settings that there are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import click
import pytest
from pymongo.uri_parser import parse_uri
from ruamel.yaml import YAML

from network.cli.main import main
from network.provisioning.new_node import store_uri_of
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.open_store import open_store
from node.main import main as run_node

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "docs" / "examples" / "mongodb"
COMPOSE = (FOLDER / "compose.yaml").read_text(encoding="utf-8")
SERVICES: dict[str, Any] = YAML(typ="safe").load(COMPOSE)["services"]
WHOLE: dict[str, Any] = YAML(typ="safe").load(COMPOSE)
SETUP: str = SERVICES["setup"]["command"][-1]
MEMBERS = [service for name, service in SERVICES.items() if re.fullmatch(r"mongo-\d", name)]
NODES = {name: service for name, service in SERVICES.items() if name.startswith("node-")}


def option(words: list[str], name: str) -> str:
    return words[words.index(name) + 1]


def spoken_commands() -> list[list[str]]:
    """Every `blockrobot ...` of the file, those in its comments too."""
    text = SETUP + "\n" + "\n".join(line for line in COMPOSE.splitlines() if line.startswith("#"))
    found = re.findall(r"\bblockrobot ([a-z][^&;}\n]*)", text)
    return [shlex.split(spoken) for spoken in found]


def addresses() -> list[str]:
    return [f"127.0.0.1:{option(member['command'], '--port')}" for member in MEMBERS]


def test_every_command_that_it_speaks_of_is_one_with_these_options() -> None:
    assert {words[0] for words in spoken_commands()} == {"up", "down", "custody"}
    for words in spoken_commands():
        command, context = main, click.Context(main)
        while isinstance(command, click.Group):
            name = words.pop(0)
            found = command.get_command(context, name)
            assert found is not None, name
            command, context = found, click.Context(found, info_name=name, parent=context)
        known = {spelled for parameter in command.params for spelled in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known


def test_the_store_that_nodes_are_given_is_the_replica_set_of_three_that_is_made() -> None:
    [up] = [words for words in spoken_commands() if words[0] == "up"]
    uri = parse_uri(option(up, "--store"))
    assert [f"{host}:{port}" for host, port in uri["nodelist"]] == addresses()
    assert len(set(addresses())) == 3
    assert {option(member["command"], "--replSet") for member in MEMBERS} == {uri["options"]["replicaSet"]}
    own = store_uri_of(option(up, "--store"), "ward-1", "node-1")
    assert parse_uri(own)["options"] == uri["options"], "a node's own database is on the same set"
    assert isinstance(open_store(own, Path("unused")), MongoStore)
    script: str = SERVICES["mongo-init"]["command"][-1]
    assert re.findall(r'host: "([^"]+)"', script) == addresses()
    assert f'_id: "{uri["options"]["replicaSet"]}"' in script


def test_it_runs_the_nodes_that_are_made_each_from_its_own_folder() -> None:
    up = main.get_command(click.Context(main), "up")
    assert up is not None
    [count] = [parameter.default for parameter in up.params if parameter.name == "nodes"]
    [folder] = {option(words, "--dir") for words in spoken_commands()}
    assert list(NODES) == [f"node-{number}" for number in range(1, count + 1)]
    for name, node in NODES.items():
        assert node["command"] == ["python", "-m", "node.main", "--data-dir", f"{folder}/nodes/{name}"]


def test_a_node_takes_the_folder_as_it_is_given_here(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run_node(["--help"])
    assert ended.value.code == 0
    assert "--data-dir" in capsys.readouterr().out


def test_what_it_waits_for_mounts_and_builds_is_there() -> None:
    for service in SERVICES.values():
        assert set(service.get("depends_on", ())) <= set(SERVICES)
        assert {volume.split(":")[0] for volume in service.get("volumes", ())} <= set(WHOLE["volumes"])
        assert ("image" in service) != ("build" in service)
        if "build" in service:
            context = (FOLDER / service["build"]["context"]).resolve()
            assert context == ROOT
            assert (context / service["build"]["dockerfile"]).is_file()
    copied = re.findall(r"/opt/blockrobot/([\w./]+)", (FOLDER / "Dockerfile").read_text(encoding="utf-8"))
    assert copied
    assert all((ROOT / name).is_file() for name in copied)


def test_nothing_of_the_example_listens_beyond_the_machine_and_the_documents_say_that_it_was_not_run() -> None:
    assert all(option(member["command"], "--bind_ip") == "127.0.0.1" for member in MEMBERS)
    assert "It was not run" in COMPOSE
    how_to = (ROOT / "docs" / "how-to" / "mongodb.md").read_text(encoding="utf-8")
    assert re.search(r"compose\.yaml\).*\n?.*Neither it nor any cluster .* was run here", how_to)
