"""Which network a bundle is of: the reader's genesis decides, and without one the verifier says whose word it is."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from clients.bundle.checks.bundle_check import unproved, verify_bundle
from clients.bundle.cli import verify
from clients.bundle.documents import write_document
from consensus.chain.genesis import genesis_to_json
from consensus.errors import BlockRobotError
from contracts.execution.genesis import complete_genesis
from tests.unit.clients.bundle.conftest import Made, make
from tests.unit.clients.bundle.repacking import judge
from tests.unit.contracts.privacy import hospital
from tests.world.ward import Ward


@pytest.fixture
def genesis_file(made: Made, tmp_path: Path) -> Path:
    path = tmp_path / "genesis.json"
    path.write_text(genesis_to_json(made.genesis), encoding="utf-8")
    return path


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(verify, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_against_a_named_genesis_file_everything_is_proved_and_said_in_plain_words(
    made: Made, genesis_file: Path
) -> None:
    code, text = run(made.path, "--genesis", genesis_file)
    assert code == 0
    for part in (
        "Everything in this file follows from its proofs.",
        "the network that you named",
        made.genesis.chain_id.hex(),
        made.genesis.block_id.hex(),
        "Up to which block: ",
        "2 visits with 3 records",
        "3 pictures, sounds or labels are what the robot committed to",
        "Not proved:",
        "that the robot saw what it committed to",
    ):
        assert part in text


def test_nobody_is_asked(made: Made, genesis_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No socket is opened, no name is looked up."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("the verifier asked somebody")

    for name in ("socket", "create_connection", "getaddrinfo"):
        monkeypatch.setattr(socket, name, refuse)
    assert run(made.path, "--genesis", genesis_file)[0] == 0


def test_the_genesis_hash_serves_as_well(made: Made) -> None:
    code, text = run(made.path, "--genesis", made.genesis.block_id.hex(), "--json")
    told = json.loads(text)
    assert code == 0
    assert (told["ok"], told["is_anchored"], told["visits"], told["records"]) == (True, True, 2, 3)
    assert told["stated_problems"] == []


def test_without_a_genesis_it_is_the_bundles_own_word(made: Made) -> None:
    code, text = run(made.path)
    assert code == 0
    assert "the bundle's own word" in text
    assert "that this is the network it says it is" in text
    assert json.loads(run(made.path, "--json")[1])["is_anchored"] is False


def test_another_network_is_refused_with_a_code_and_a_next_step(made: Made) -> None:
    code, text = run(made.path, "--genesis", "00" * 32, "--json")
    told = json.loads(text)
    assert code == 1
    assert (told["ok"], told["error"]["code"]) == (False, "BUNDLE_OTHER_CHAIN")
    assert told["error"]["next_step"]


def test_the_chain_id_is_told_apart_from_the_genesis_hash(made: Made) -> None:
    """It does not cover the state that the network began with."""
    with pytest.raises(BlockRobotError, match=made.genesis.block_id.hex()) as caught:
        verify_bundle(made.path, made.genesis.chain_id)
    assert caught.value.code == "BUNDLE_OTHER_CHAIN"


def test_no_file_no_genesis_and_no_bundle_have_exit_codes_of_their_own(made: Made, tmp_path: Path) -> None:
    assert run(tmp_path / "none.zip")[0] == 3
    assert run(made.path, "--genesis", tmp_path / "none.json")[0] == 1
    (tmp_path / "text.zip").write_text("hello")
    assert run(tmp_path / "text.zip")[0] == 1


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Ward:
    """A ward of a network with another genesis, made by the same people with the same keys."""
    genesis = msgspec.structs.replace(hospital.build_genesis(), network="elsewhere", state_root=b"")
    monkeypatch.setattr(hospital, "build_genesis", lambda *_: complete_genesis(genesis))
    (tmp_path / "elsewhere").mkdir()
    ward = Ward(tmp_path / "elsewhere")
    ward.record(ward.open_visit())
    return ward


async def test_a_chain_that_somebody_made_up_is_sound_in_itself_and_refused_against_the_real_one(
    made: Made, elsewhere: Ward, tmp_path: Path
) -> None:
    """Anybody can be a network of his own: without a genesis only the agreement with itself can be said."""
    await make(elsewhere, tmp_path / "elsewhere.zip")
    alone = verify_bundle(tmp_path / "elsewhere.zip")
    assert "the bundle's own word" in unproved(alone)[0]
    assert verify_bundle(tmp_path / "elsewhere.zip", elsewhere.genesis).is_anchored
    with pytest.raises(BlockRobotError, match=r"^BUNDLE_OTHER_CHAIN:"):
        verify_bundle(tmp_path / "elsewhere.zip", made.genesis)


async def test_proofs_of_one_network_prove_nothing_in_another(made: Made, elsewhere: Ward, tmp_path: Path) -> None:
    contents = await make(elsewhere, tmp_path / "elsewhere.zip")
    state = write_document(contents.proofs.visits[0])
    forged = made.forge(made.files | {"proofs/state-0001.json": state})
    verdict = judge(tmp_path / "x.zip", forged, made.genesis)
    assert isinstance(verdict, BlockRobotError)
    assert "another chain" in verdict.detail
