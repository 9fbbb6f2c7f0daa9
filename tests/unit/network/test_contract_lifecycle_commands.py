"""`contract propose`, `approve`, `list`, `show`, `diff` and their kin, in front of a consortium in memory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import network.cli.governance.governance_signer as governing
import network.contracts.chain_contracts as chain_contracts
from consensus.chain.genesis import genesis_to_json
from consensus.errors import CATALOGUE
from contracts.lifecycle.registry import read_source
from contracts.vm import compile_contract
from network.cli.contract.contract_commands import contract
from tests.unit.clients.sdk.consortium_client import ConsortiumClient
from tests.unit.contracts.system.consortium import Consortium, admin_of, key_of
from tests.unit.contracts.system.deploying import FAILING, VISITORS, VISITORS_2


@pytest.fixture
def chain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Consortium:
    """Three organisations whose folders lie in the network's folder; a file visitors.py beside it."""
    chain = Consortium()
    folder = tmp_path / "network"
    for name in chain.organisations:
        place = folder / "organisations" / name
        place.mkdir(parents=True)
        (place / "admin.key").write_bytes(admin_of(name).secret)
    (folder / "genesis.json").write_text(genesis_to_json(chain.genesis), encoding="utf-8")
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(governing, "open_pinned_client", lambda _genesis, _path: ConsortiumClient(chain, set()))
    Path("visitors.py").write_text(VISITORS, encoding="utf-8")
    return chain


def run(*arguments: str) -> Result:
    return CliRunner().invoke(contract, list(arguments))


def answer(*arguments: str) -> dict[str, Any]:
    result = run(*arguments, "--json")
    document: dict[str, Any] = json.loads(result.stdout)
    assert document["ok"] == (result.exit_code == 0), result.output
    return document


def refusal(*arguments: str) -> str:
    spoken = run(*arguments)
    assert "Next step: " in spoken.stderr
    problem = answer(*arguments)["error"]
    assert problem["next_step"] == CATALOGUE[problem["code"]].next_step
    return str(problem["code"])


def decide(*arguments: str) -> dict[str, Any]:
    """The first organisation proposes, the second approves."""
    opened = answer(*arguments, "--as", "org-01")["proposal"]["id"]
    return answer("approve", opened[:12], "--as", "org-02", "--no-wait")


def deploy(chain: Consortium, source: str = VISITORS) -> None:
    Path("visitors.py").write_text(source, encoding="utf-8")
    decide("propose", "visitors.py")
    chain.block([])


def test_a_contract_goes_from_a_file_to_the_chain(chain: Consortium) -> None:
    proposed = run("propose", "visitors.py", "--as", "org-01", "--note", "for the entrance")
    opened = answer("list")["proposals"][0]["id"][:12]
    assert f"contract approve {opened} --as ORG" in proposed.output
    assert f"contract show visitors --proposal {opened} --source" in proposed.output
    assert run("show", "visitors", "--proposal", opened, "--source").stdout == VISITORS
    approved = run("approve", opened, "--as", "org-02", "--no-wait").output.splitlines()
    height = chain.height + 1
    assert approved == [
        f"deploy visitors: decided at height {height - 1}, takes effect with block {height}.",
        "Next step: blockrobot contract show visitors",
    ]
    assert "to come" in run("list").output
    assert answer("list")["due"][0]["from_height"] == height
    assert "approved; " in run("show", "visitors").output
    chain.must(key_of("anyone"), "visitors", "enter", "Ada")
    shown = run("show", "visitors").output
    assert f"active since height {height}" in shown
    assert "proposed by org-01" in shown
    assert "for the entrance" in shown
    assert "export  enter(name: str) -> object" in shown


def test_list_and_show_as_json(chain: Consortium) -> None:
    deploy(chain)
    listed = answer("list")
    assert listed["due"] == listed["proposals"] == []
    rows = {row["name"]: row for row in listed["contracts"]}
    assert (rows["visitors"]["version"], rows["visitors"]["enabled"], len(rows)) == (1, True, 15)
    shown = answer("show", "visitors")
    assert (shown["status"], shown["source"], shown["organisation"]) == ("active", VISITORS, "org-01")
    assert [entry["name"] for entry in shown["abi"]] == ["enter", "leave", "inside"]
    assert answer("show", "records")["source"] == read_source("records")
    assert run("show", "visitors", "--abi").output.splitlines()[2] == "  view    inside() -> list"


def test_an_upgrade_is_compared_then_activated_at_a_height_and_rolled_back(chain: Consortium) -> None:
    deploy(chain)
    Path("visitors.py").write_text(VISITORS_2, encoding="utf-8")
    compared = answer("diff", "visitors", "visitors.py")
    assert [change["change"] for change in compared["abi"]] == ["changed", "removed"]
    assert '-    state.delete(b"in/" + name.encode())' in compared["diff"]
    decided = decide("propose", "visitors.py", "--delay", "3")
    assert decided["due_height"] == decided["height"] + 3
    for _ in range(3):
        chain.block([])
    assert answer("show", "visitors")["version"] == 2
    spoken = run("diff", "visitors", "1", "2").output
    assert "changed     export enter(name: str) -> object  ->  export enter(name: str, floor: int)" in spoken
    assert "removed     export leave(name: str) -> object" in spoken
    assert run("diff", "visitors", "visitors.py").output.startswith("visitors version 2 and visitors.py are equal.")
    decide("activate", "visitors", "1")
    chain.block([])
    assert answer("show", "visitors")["version"] == 1
    assert answer("show", "visitors", "--version", "2")["status"] == "superseded"


def test_a_proposal_can_be_compared_before_it_is_approved(chain: Consortium) -> None:
    deploy(chain)
    Path("visitors.py").write_text(VISITORS + "\n\n@view\ndef count() -> int:\n    return 1\n", encoding="utf-8")
    opened = answer("propose", "visitors.py", "--as", "org-01")["proposal"]["id"]
    compared = answer("diff", "visitors", opened[:12])
    assert compared["abi"] == [{"change": "added", "entry": "view count() -> int"}]
    run("withdraw", opened[:12], "--as", "org-01")
    assert refusal("diff", "visitors", opened[:12]) == "GOVERNANCE_PROPOSAL_CLOSED"
    assert (
        "'visitor.py' is no version's number, no file, and no open proposal about visitors."
        in run("diff", "visitors", "visitor.py").stderr
    )


def test_a_proposed_source_is_shown_and_compared_without_compiling_it_here(
    chain: Consortium, monkeypatch: pytest.MonkeyPatch
) -> None:
    deploy(chain)
    Path("visitors.py").write_text(VISITORS + "# again\n", encoding="utf-8")
    opened = answer("propose", "visitors.py", "--as", "org-01")["proposal"]["id"][:12]
    monkeypatch.setattr(chain_contracts, "compile_contract", lambda *_: pytest.fail("compiled"))
    here = {entry.name for entry in compile_contract(VISITORS, "visitors").abi.entries}
    assert {entry["name"] for entry in answer("show", "visitors", "--proposal", opened)["abi"]} == here
    assert answer("diff", "visitors", opened)["abi"] == []


def test_what_is_no_text_is_neither_proposed_nor_compared_and_long_lines_stay_whole(chain: Consortium) -> None:
    deploy(chain)
    Path("visitors.py").write_bytes(b"\xff\xfe")
    assert refusal("propose", "visitors.py", "--as", "org-01") == "FILE_UNUSABLE"
    assert "visitors.py is not a text file" in run("diff", "visitors", "visitors.py").stderr
    remark = "# " + "who is in the house, and since when, " * 5
    Path("visitors.py").write_text(VISITORS + remark + "\n", encoding="utf-8")
    assert f"+{remark}" in run("diff", "visitors", "visitors.py").output.splitlines()


def test_a_version_that_could_not_take_effect_says_why(chain: Consortium) -> None:
    deploy(chain)
    deploy(chain, FAILING)
    assert answer("show", "visitors")["version"] == 1
    failed = run("show", "visitors", "--version", "2").output
    assert "It did not take effect: TOO_EARLY: Not yet. (line 17)" in failed
    assert "Next step: mend the source" in failed
    failure = "TOO_EARLY: Not yet. (line 17)"
    assert f"visitors version 2 failed at height {chain.height}: {failure}" in run("show", "visitors").output
    assert f"visitors version 2 failed at height {chain.height}: {failure}" in run("list").output
    row = {"name": "visitors", "version": 2, "since_height": chain.height, "failure": failure}
    assert answer("show", "visitors")["failed"] == row
    assert answer("list")["failed"] == [row]


def test_a_proposal_without_a_source_is_shown_for_what_it_is(chain: Consortium) -> None:
    deploy(chain)
    deploy(chain, VISITORS_2)
    for kind, arguments in (("activate", ["1"]), ("disable", [])):
        opened = answer(kind, "visitors", *arguments, "--note", "too many floors", "--as", "org-01")["proposal"]["id"]
        version = 1 if kind == "activate" else 2
        line = f"Proposal {opened[:12]}: {kind} visitors version {version}, proposed by org-01: too many floors"
        assert line in run("show", "visitors", "--proposal", opened[:12]).output
        assert "approved by org-01, 2 needed" in run("show", "visitors", "--proposal", opened[:12]).output
        assert line in run("diff", "visitors", opened[:12]).output
        shown = answer("show", "visitors", "--proposal", opened[:12])
        assert (shown["version"], shown["proposal"]["kind"]) == (version, kind)
        assert answer("diff", "visitors", opened[:12])["proposals"][0]["organisation"] == "org-01"
        assert line in run("list").output
        assert "is about visitors" in run("show", "records", "--proposal", opened[:12]).stderr


def test_a_contract_is_disabled_and_listed_as_that(chain: Consortium) -> None:
    deploy(chain)
    decide("disable", "visitors", "--note", "wrong floors")
    chain.block([])
    assert not {row["name"]: row for row in answer("list")["contracts"]}["visitors"]["enabled"]
    assert "disabled since height" in run("show", "visitors").output
    assert refusal("disable", "visitors", "--as", "org-01") == "GOVERNANCE_CONTRACT_REFUSED"


def test_what_governs_is_on_trial_until_it_is_kept(chain: Consortium) -> None:
    source = read_source("forms").replace("HOST_MAX_CHARS = 253", "HOST_MAX_CHARS = 200")
    Path("forms.py").write_text(source, encoding="utf-8")
    decide("propose", "forms.py")
    chain.block([])
    assert "Next step: blockrobot contract keep forms --as ORG" in run("show", "forms").output
    decide("keep", "forms")
    assert "version 2 kept with block" in run("show", "forms").output
    chain.block([])
    assert answer("list")["due"] == []


def test_mistakes_are_found_before_anything_is_sent(chain: Consortium) -> None:
    Path("broken.py").write_text("import os\n", encoding="utf-8")
    assert refusal("propose", "broken.py", "--as", "org-01") == "CONTRACT_SOURCE_INVALID"
    assert chain.height == 0
    assert refusal("show", "nothing") == "CONTRACT_NOT_FOUND"
    assert refusal("show", "records", "--version", "7") == "CONTRACT_NOT_FOUND"
    assert refusal("approve", "abcdef123456", "--as", "org-01") == "GOVERNANCE_PROPOSAL_CLOSED"
    Path("state.py").write_text(VISITORS, encoding="utf-8")
    assert refusal("propose", "state.py", "--as", "org-01") == "GOVERNANCE_CONTRACT_REFUSED"


def test_a_check_that_moved_into_a_comment_is_never_called_equal(chain: Consortium) -> None:
    """What other readers take for the end of a line is none: such a source is refused, and no diff hides it."""
    deploy(chain)
    for end in ("\x85", "\u2028", "\u2029", "\x0b", "\x0c", "\x1c", "\r"):
        joined = VISITORS.replace("\n    ", f"  #{end}    ", 1)
        Path("visitors.py").write_bytes(joined.encode())
        assert refusal("diff", "visitors", "visitors.py") == "CONTRACT_SOURCE_INVALID"
        assert refusal("propose", "visitors.py", "--as", "org-01") == "CONTRACT_SOURCE_INVALID"


def test_sources_are_equal_only_if_their_hashes_are(chain: Consortium) -> None:
    deploy(chain)
    same = answer("diff", "visitors", "visitors.py", "--exit-code")
    assert same["equal"]
    assert same["old_hash"] == same["new_hash"]
    assert same["diff"] == []
    for other in (VISITORS.rstrip("\n"), VISITORS + "\n", VISITORS + "# \u0430\n"):
        Path("visitors.py").write_bytes(other.encode())
        found = answer("diff", "visitors", "visitors.py")
        assert not found["equal"]
        assert found["old_hash"] != found["new_hash"]
        assert found["diff"]
        spoken = run("diff", "visitors", "visitors.py")
        assert "are equal" not in spoken.output
        assert run("diff", "visitors", "visitors.py", "--exit-code").exit_code == 1
    assert "+ U+0430" in spoken.output
