"""`contract events`: where it stopped it goes on, without loss and without saying anything twice."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import network.cli.contract.contract_events_commands as command
import network.cli.governance.governance_signer as governance_signer
from clients.sdk.chain.contract_events import EventPage, FoundEvent, Place
from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from network.cli.contract.contract_commands import contract
from tests.json_answers import differences
from tests.unit.clients.sdk.consortium_client import ConsortiumClient
from tests.unit.contracts.system.consortium import Consortium, admin_of


class Story:
    """What the nodes answer, one page after another: events by place, a refusal, or the end of the story."""

    def __init__(self) -> None:
        self.events: dict[Place, FoundEvent] = {}
        self.asked: list[Place | None] = []
        self.interruptions: list[BlockRobotError | type[BaseException]] = []
        self.page_size = 2

    def happen(self, *places: str) -> None:
        for text in places:
            height, index = map(int, text.split(":"))
            place = Place(height, index)
            self.events[place] = FoundEvent(place, "notes", "written", {"at": text, "by": b"\x01"}, bytes(32))

    async def read(
        self, client: Any, key: Any, first: Place | None, *, contract: str | None, name: str | None, wait_ms: int
    ) -> EventPage:
        self.asked.append(first)
        if self.interruptions:
            raise self.interruptions.pop(0)
        begin = first or Place(0, 0)
        found = [event for place, event in sorted(self.events.items()) if place >= begin]
        head = max((place.height for place in self.events), default=0)
        if len(found) > self.page_size:
            return EventPage(tuple(found[: self.page_size]), found[self.page_size].place, head)
        return EventPage(tuple(found), max(Place(head + 1, 0), begin), head)


@pytest.fixture
def story(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Story:
    chain, story = Consortium(), Story()
    place = tmp_path / "network" / "organisations" / "org-01"
    place.mkdir(parents=True)
    (place / "admin.key").write_bytes(admin_of("org-01").secret)
    (tmp_path / "network" / "genesis.json").write_text(genesis_to_json(chain.genesis), encoding="utf-8")
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.setattr(governance_signer, "open_pinned_client", lambda _genesis, _path: ConsortiumClient(chain))
    monkeypatch.setattr(command, "read_events", story.read)
    monkeypatch.setattr(command, "RETRY_S", 0)
    monkeypatch.setattr(command, "PAUSE_S", 0)
    return story


def run(*arguments: str) -> Result:
    return CliRunner().invoke(contract, ["events", *arguments])


def shown(result: Result) -> list[str]:
    return [line.split()[0] for line in result.stdout.splitlines()]


def written(path: Path) -> Sequence[str]:
    return [json.loads(line)["place"] for line in path.read_text(encoding="utf-8").splitlines()]


def test_all_events_are_shown_in_order(story: Story) -> None:
    story.happen("1:0", "1:1", "3:0")
    result = run()
    assert result.stderr == ""
    assert result.stdout.splitlines()[0] == '1:0  notes.written {"at": "1:0", "by": 0x01}'
    assert shown(result) == ["1:0", "1:1", "3:0"]
    assert shown(run("--from", "1:1")) == ["1:1", "3:0"]
    first = json.loads(run("--json").stdout.splitlines()[0])
    assert differences("contract events", first) == []
    assert first == {
        "place": "1:0",
        "contract": "notes",
        "name": "written",
        "data": {"at": "1:0", "by": "01"},
        "txid": "00" * 32,
    }


def test_a_state_file_remembers_where_to_go_on(story: Story, tmp_path: Path) -> None:
    state = tmp_path / "cursor"
    story.happen("1:0", "1:1", "3:0")
    assert shown(run("--state", str(state))) == ["1:0", "1:1", "3:0"]
    assert shown(run("--state", str(state))) == []
    story.happen("4:0", "4:1")
    assert shown(run("--state", str(state), "--from", "0:0")) == ["4:0", "4:1"]
    others = run("--state", str(state), "--contract", "notes", "--name", "other")
    assert (others.exit_code, "EVENTS_STATE_OF_OTHERS" in others.stderr) == (1, True)
    assert "among all events, and you ask for the events other of the contract notes." in others.stderr
    link = tmp_path / "link"
    link.symlink_to(state)
    assert "FILE_EXISTS" in run("--state", str(link)).stderr
    assert link.is_symlink()
    state.write_text("{}", encoding="utf-8")
    assert "EVENTS_STATE_BROKEN" in run("--state", str(state)).stderr


def test_a_follower_goes_on_while_no_node_answers_until_it_is_stopped(story: Story, tmp_path: Path) -> None:
    state = tmp_path / "cursor"
    story.happen("1:0", "1:1", "3:0")
    story.interruptions = [BlockRobotError("NODE_UNREACHABLE", "Nobody is there."), BlockRobotError("NODE_NOT_READY")]
    taken: list[Place | None] = story.asked

    async def until_all_was_read(*arguments: Any, **more: Any) -> EventPage:
        if len(taken) == 4:
            raise BlockRobotError("BLOCK_PRUNED")
        return await story.read(*arguments, **more)

    command.read_events = until_all_was_read  # type: ignore[assignment]
    result = run("--follow", "--state", str(state))
    assert shown(result) == ["1:0", "1:1", "3:0"]
    assert result.stderr.splitlines()[0] == "Nobody is there. Still asking."
    assert "BLOCK_PRUNED" in result.stderr
    assert json.loads(state.read_text(encoding="utf-8"))["next"] == "4:0"


def test_a_kill_in_the_middle_of_a_page_says_nothing_twice_in_a_file(story: Story, tmp_path: Path) -> None:
    out = tmp_path / "events.jsonl"
    story.happen("1:0", "1:1", "3:0", "3:1", "5:0")
    assert run("--out", str(out)).stdout == ""
    whole = out.read_bytes()
    for cut in range(0, len(whole) + 1, 7):
        out.write_bytes(whole[:cut])
        run("--out", str(out))
        assert out.read_bytes() == whole
    assert written(out) == ["1:0", "1:1", "3:0", "3:1", "5:0"]
    for other in ("something else\n", "something else", '{"place": "1:0"}\nand something else', "\n", '{"plan": 1}'):
        out.write_text(other, encoding="utf-8")
        assert "EVENTS_FILE_FOREIGN" in run("--out", str(out)).stderr
        assert out.read_text(encoding="utf-8") == other
    assert run("--out", str(out), "--state", str(out)).exit_code == 2


def test_a_contract_or_a_place_that_is_none_is_told(story: Story) -> None:
    story.happen("1:0")
    unknown = run("--contract", "nope")
    assert (unknown.exit_code, "The chain has no contract 'nope'" in unknown.stderr) == (0, True)
    assert run("--contract", "settings").stderr == ""
    ahead = run("--from", "999999:0")
    assert (ahead.exit_code, ahead.stderr) == (0, "The place 999999:0 is not there yet: the newest block is 1.\n")
    assert run("--from", "2:0").stderr == ""
    for wrong in ("yesterday", "7", "7:", "-1:0"):
        result = run("--from", wrong)
        assert (result.exit_code, "height:index" in result.stderr) == (2, True)
