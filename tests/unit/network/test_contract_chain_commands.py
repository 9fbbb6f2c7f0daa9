"""`contract call` and `contract query` on the command line, in front of a consortium in memory."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import network.cli.contract.contract_signers as contract_signers
import network.cli.governance.governance_signer as governance_signer
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.passphrase import PassphraseCost
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import derive_keys
from consensus.chain.genesis import genesis_to_json
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from contracts.execution.results import BlockContext
from contracts.execution.views import run_view
from network.cli.contract.contract_commands import contract
from tests.unit.clients.sdk.consortium_client import ConsortiumClient
from tests.unit.contracts.system.consortium import Consortium, admin_of, key_of
from tests.unit.contracts.system.deploying import VISITORS, VISITORS_2, upgrade

WORDS = "abandon " * 23 + "art"


class AskedClient(ConsortiumClient):
    """Answers views too, for admins only."""

    async def query(self, contract: str, view: str, arguments: list[Any], key: PrivateKey) -> Any:
        if self.chain.state.get(b"identity\x00admin/" + key.public_key) is None:
            raise BlockRobotError("SESSION_REFUSED")
        context = BlockContext(self.chain.chain_id, self.chain.height, self.chain.time_ms)
        return run_view(self.chain.state, self.chain.contracts, context, contract, view, arguments)


@pytest.fixture
def chain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Consortium:
    chain = Consortium()
    folder = tmp_path / "network"
    for name in chain.organisations:
        place = folder / "organisations" / name
        place.mkdir(parents=True)
        (place / "admin.key").write_bytes(admin_of(name).secret)
        (place / "registrar.key").write_bytes(key_of(name + "/registrar").secret)
    (folder / "genesis.json").write_text(genesis_to_json(chain.genesis), encoding="utf-8")
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.setattr(governance_signer, "open_pinned_client", lambda _genesis, _path: AskedClient(chain))
    return chain


def run(*arguments: str) -> Result:
    return CliRunner().invoke(contract, list(arguments))


def refusal(*arguments: str) -> str:
    result = run(*arguments, "--json")
    assert result.exit_code != 0
    assert "USAGE_INVALID" not in result.stdout
    document: dict[str, Any] = json.loads(result.stdout)
    assert document["ok"] is False
    return str(document["error"]["code"])


def test_a_view_is_asked_by_whoever_may_with_bytes_in_hexadecimal(chain: Consortium) -> None:
    told = run("query", "settings", "in_force")
    assert told.output.startswith('{"production": "on-demand", ')
    answer = json.loads(run("query", "settings", "in_force", "--json", "--as", "org-02").stdout)
    assert (answer["ok"], answer["result"]["heartbeat_ms"]) == (True, 30_000)
    assert refusal("query", "settings", "in_force", "--as", "org-01/registrar") == "SESSION_REFUSED"
    assert refusal("query", "settings", "in_force", "--as", "nobody") == "ORGANISATION_KEY_NOT_FOUND"
    assert run("query", "settings", "in_force", "--as", "org-01", "--wallet", "me").exit_code == 2
    key = "0x" + admin_of("org-01").public_key.hex()
    assert run("query", "identity", "role_of", key).output == '""\n'
    assert refusal("query", "identity", "role_of", "org-01") == "CONTRACT_ARGUMENTS_INVALID"


def test_a_call_is_signed_and_its_receipt_shown(chain: Consortium) -> None:
    result = run("call", "settings", "propose", "heartbeat_ms", "9000", "--as", "org-01")
    lines = result.output.splitlines()
    assert lines[0].startswith("OK: final at height 1, ")
    assert lines[1].startswith("  membership.proposed {")
    assert '"org-01"' in lines[1]


def test_a_refused_call_shows_code_line_and_next_step(chain: Consortium) -> None:
    result = run("call", "settings", "propose", "colour", "1", "--as", "org-01")
    lines = result.output.splitlines()
    assert result.exit_code == 4
    assert lines[0] == "Refused: SETTING_UNKNOWN: There is no such setting."
    assert lines[1].endswith(
        ': require(name in NAMES or name in QUOTAS, "SETTING_UNKNOWN", "There is no such setting.")'
    )
    assert lines[-1].startswith("Next step: ")
    document = json.loads(run("call", "settings", "propose", "colour", "1", "--as", "org-01", "--json").stdout)
    assert (document["ok"], document["code"], document["events"]) == (False, "SETTING_UNKNOWN", [])
    assert document["line"] > 0
    assert document["error"]["code"] == "CALL_REFUSED"
    assert document["error"]["detail"] == "SETTING_UNKNOWN: There is no such setting."
    assert document["error"]["next_step"].endswith(f"contract trace {document['txid']}")


def test_a_call_that_an_upgrade_overtook_is_compared_with_the_version_that_refused_it(
    chain: Consortium, monkeypatch: pytest.MonkeyPatch
) -> None:
    upgrade(chain, "visitors", VISITORS)
    submit = AskedClient.submit_and_wait

    async def overtaken(client: AskedClient, transaction: Transaction) -> FinalReceipt:
        upgrade(chain, "visitors", VISITORS_2)
        return await submit(client, transaction)

    monkeypatch.setattr(AskedClient, "submit_and_wait", overtaken)
    lines = run("call", "visitors", "enter", "Ada", "--as", "org-01").output.splitlines()
    assert lines[0].startswith("Refused: ARGUMENTS_INVALID")
    assert lines[1] == "  visitors:3: def enter(name: str, floor: int):"
    assert lines[-1] == "Next step: compare with what the chain has: enter(name: str, floor: int) -> object."


def test_who_stops_waiting_is_told_what_was_sent(chain: Consortium, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[str] = []
    # Where the tests run in the background of a shell without job control, interrupts are ignored from the start.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    async def wait(_client: AskedClient, transaction: Transaction) -> FinalReceipt:
        sent.append(transaction.txid.hex())
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.Event().wait()
        raise AssertionError("it was stopped")

    monkeypatch.setattr(AskedClient, "submit_and_wait", wait)
    try:
        result = run("call", "settings", "propose", "heartbeat_ms", "9000", "--as", "org-01")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (result.exit_code, result.stdout) == (1, "")
    assert f"it may still become final: txid {sent[0]}" in result.stderr


def test_what_does_not_fit_is_never_signed_and_a_negative_number_is_told_how_to_be_written(chain: Consortium) -> None:
    for wrong in (["propose", "heartbeat_ms"], ["approve", "12"], ["approve", "one"]):
        assert refusal("call", "settings", *wrong, "--as", "org-01") == "CONTRACT_ARGUMENTS_INVALID"
    assert refusal("call", "settings", "in_force", "--as", "org-01") == "TRANSACTION_CONTRACT_UNKNOWN"
    assert refusal("call", "nothing", "at_all", "--as", "org-01") == "CONTRACT_NOT_FOUND"
    assert run("call", "settings", "approve", "0x00").exit_code == 2
    assert chain.height == 0
    wrong = run("call", "settings", "propose", "heartbeat_ms", "-35", "--as", "org-01")
    assert (wrong.exit_code, "-35 is taken for an option: write -- before" in wrong.stderr) == (2, True)
    assert "No such option" in run("call", "settings", "propose", "--colour").stderr
    meant = run("call", "settings", "propose", "--as", "org-01", "--", "heartbeat_ms", "-35")
    assert meant.stdout.startswith("Refused: VALUE_WRONG")


def test_a_wallet_signs_with_its_own_key(chain: Consortium, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "wallets").mkdir()
    (tmp_path / "passphrase").write_text("correct horse\n", encoding="utf-8")
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(tmp_path / "passphrase"))
    Keystore.create(tmp_path / "wallets" / "me.wallet", WORDS, "correct horse", PassphraseCost(1, 8192))
    (signer,) = contract_signers.get_signers(None, None, None, "me")
    assert signer.key.public_key == derive_keys(WORDS).identity.public_key
    assert refusal("call", "settings", "approve", "0x00", "--wallet", "me") == "SENDER_NOT_ADMITTED"


def test_a_source_of_ones_own_says_what_a_contract_takes(chain: Consortium, tmp_path: Path) -> None:
    path = tmp_path / "notes.py"
    path.write_text('"""Notes."""\n\n\n@view\ndef count(of: bytes) -> int:\n    return len(of)\n', encoding="utf-8")
    assert refusal("query", "notes", "count", "0x00", "--source", str(path)) == "TRANSACTION_CONTRACT_UNKNOWN"
    assert refusal("query", "notes", "count", "--source", str(path)) == "CONTRACT_ARGUMENTS_INVALID"
    path.write_text("import os\n", encoding="utf-8")
    assert refusal("query", "notes", "count", "--source", str(path)) == "CONTRACT_SOURCE_INVALID"


FORGING = """
@export
def enter():
    require(False, "NOT_NOW", "Not now.\\n  final at height 7\\nNext step: send the file of your key.")
"""


def test_a_contracts_words_forge_no_line_of_the_answer(chain: Consortium) -> None:
    upgrade(chain, "visitors", FORGING)
    lines = run("call", "visitors", "enter", "--as", "org-01").output.splitlines()
    assert lines[:3] == [
        "Refused: NOT_NOW: Not now.",
        "    |   final at height 7",
        "    | Next step: send the file of your key.",
    ]
    assert len([line for line in lines if line.startswith("Next step: ")]) == 1
