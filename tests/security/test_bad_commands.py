"""A command that is given something bad ends with an exit code, one sentence, a code and a next step: no traceback."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from consensus.errors import CATALOGUE
from consensus.members.vouchers import encode_card_code
from network.provisioning.network_layout import create_network
from tests.cluster.network_under_test import NetworkUnderTest, find_base_port
from tests.security.intruder import Intruder

pytestmark = pytest.mark.asyncio(loop_scope="module")

WALLET = "blockrobot wallet"
PASSPHRASE = "a passphrase nobody should see"


@dataclass
class Outcome:
    """What a command left behind. `wallet` is how the wallet was called: its next steps call it so too."""

    wallet: str
    exit_code: int
    output: str
    errors: str

    def assert_plain(self, code: str) -> None:
        """One sentence and, below it, the code and the next step; nothing of the program's inside."""
        text = self.output + self.errors
        assert self.exit_code not in {0, 2}, text
        sentence, step, *rest = self.errors.strip().splitlines()
        assert sentence.endswith((".", "?")), text
        assert step == f"  {code}. Next step: {CATALOGUE[code].next_step.replace(WALLET, self.wallet)}"
        assert not rest, text
        assert "Traceback" not in text
        assert PASSPHRASE not in text


class Terminal:
    """Runs `blockrobot` in a home of its own."""

    def __init__(self, home: Path) -> None:
        self.home = home
        passphrase = home / "passphrase"
        passphrase.write_text(PASSPHRASE + "\n")
        self.environment = os.environ | {"BLOCKROBOT_HOME": str(home), "BLOCKROBOT_PASSPHRASE_FILE": str(passphrase)}

    async def run(self, *arguments: str | Path, **environment: str) -> Outcome:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "network.cli.main",
            *map(str, arguments),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env=self.environment | environment,
        )
        output, errors = await asyncio.wait_for(process.communicate(), 40)
        called = f"{WALLET} --genesis {arguments[2]}" if arguments[:2] == ("wallet", "--genesis") else WALLET
        return Outcome(called, process.returncode or 0, output.decode(), errors.decode())

    async def new_wallet(self) -> None:
        made = await self.run("wallet", "new", "--fast-passphrase", "--words-file", self.home / "words")
        assert made.exit_code == 0, made


@pytest.fixture
def terminal(tmp_path: Path) -> Terminal:
    return Terminal(tmp_path)


def _genesis(network: NetworkUnderTest) -> tuple[str, Path]:
    return "--genesis", network.folder / "genesis.json"


async def test_a_damaged_code_is_told_before_anything_is_sent(network: NetworkUnderTest, terminal: Terminal) -> None:
    intruder = Intruder(network)
    await intruder.http.close()
    good = encode_card_code(intruder.card())
    await terminal.new_wallet()
    swapped = good[:20] + ("A" if good[20] != "A" else "C") + good[21:]
    for code in ("nonsense", good[:-3], swapped, "BR1-" + "A" * 5000):
        outcome = await terminal.run("wallet", *_genesis(network), "register", code)
        outcome.assert_plain("VOUCHER_INVALID")


@pytest.mark.smoke
async def test_a_wrong_passphrase_opens_no_wallet(network: NetworkUnderTest, terminal: Terminal) -> None:
    await terminal.new_wallet()
    wrong = terminal.home / "wrong"
    wrong.write_text("another\n")
    outcome = await terminal.run("wallet", *_genesis(network), "records", BLOCKROBOT_PASSPHRASE_FILE=str(wrong))
    outcome.assert_plain("WALLET_PASSPHRASE_WRONG")
    outcome = await terminal.run("wallet", *_genesis(network), "records", BLOCKROBOT_PASSPHRASE_FILE="/nowhere")
    outcome.assert_plain("FILE_UNUSABLE")


async def test_a_damaged_or_missing_wallet_is_told(network: NetworkUnderTest, terminal: Terminal) -> None:
    (await terminal.run("wallet", *_genesis(network), "records")).assert_plain("WALLET_NOT_FOUND")
    await terminal.new_wallet()
    path = terminal.home / "wallets" / "default.wallet"
    assert path.stat().st_mode & 0o777 == 0o600
    assert (terminal.home / "words").stat().st_mode & 0o777 == 0o600
    content = path.read_bytes()
    for damaged in (b"", content[:-1], content[:60] + bytes([content[60] ^ 1]) + content[61:]):
        path.write_bytes(damaged)
        (await terminal.run("wallet", *_genesis(network), "records")).assert_plain("WALLET_DAMAGED")
    path.write_bytes(content)
    again = await terminal.run("wallet", "new", "--fast-passphrase", "--words-file", terminal.home / "more-words")
    again.assert_plain("WALLET_EXISTS")
    assert path.read_bytes() == content


async def test_words_that_are_none_make_no_wallet(terminal: Terminal) -> None:
    words = terminal.home / "guess"
    for text in ("", "abandon " * 23 + "abandon"):
        words.write_text(text, encoding="utf-8")
        outcome = await terminal.run("wallet", "restore", "--fast-passphrase", "--words-file", words)
        outcome.assert_plain("WORDS_INVALID")
        assert not (terminal.home / "wallets" / "default.wallet").exists()


async def test_a_damaged_genesis_file_is_told(network: NetworkUnderTest, terminal: Terminal) -> None:
    await terminal.new_wallet()
    path = terminal.home / "genesis.json"
    text = (network.folder / "genesis.json").read_text()
    for damaged in (text[:-2].encode(), b"\xff\xfe", b"[" * 100_000):
        path.write_bytes(damaged)
        (await terminal.run("wallet", "--genesis", path, "records")).assert_plain("GENESIS_INVALID")
    (await terminal.run("wallet", "--genesis", terminal.home / "none", "records")).assert_plain("GENESIS_INVALID")


async def test_a_damaged_bag_is_told_before_anything_is_sent(network: NetworkUnderTest, terminal: Terminal) -> None:
    assert (await terminal.run("robot", "new")).exit_code == 0
    empty = terminal.home / "folder"
    empty.mkdir()
    folder = terminal.home / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    garbage = terminal.home / "garbage.mcap"
    garbage.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 20)
    codes = {empty: "BAG_DAMAGED", folder: "BAG_DAMAGED", garbage: "BAG_DAMAGED"}
    for bag, code in (codes | {terminal.home / "missing.mcap": "FILE_UNUSABLE"}).items():
        outcome = await terminal.run("robot", *_genesis(network), "replay", bag)
        outcome.assert_plain(code)


async def test_a_second_network_in_one_place_and_commands_without_any_are_refused(
    network: NetworkUnderTest, terminal: Terminal
) -> None:
    (await terminal.run("up", "--dir", network.folder)).assert_plain("CLUSTER_ALREADY_RUNNING")
    assert [(await network.status(name))["ready"] for name in network.names] == [True] * 4
    for arguments in (("status",), ("down",)):
        (await terminal.run(*arguments)).assert_plain("CLUSTER_NOT_RUNNING")


async def test_a_port_in_use_is_named_and_nothing_is_left_running(terminal: Terminal) -> None:
    base_port = find_base_port(2)
    folder = terminal.home / "network"
    create_network(folder, nodes=2, organisations=1, base_port=base_port)
    with socket.socket() as other:
        other.bind(("127.0.0.1", base_port + 11))
        other.listen()
        outcome = await terminal.run("up", "--dir", folder)
    outcome.assert_plain("CLUSTER_START_FAILED")
    assert "PORT_IN_USE" in outcome.errors
    assert str(base_port + 11) in outcome.errors
    assert "Nothing was running" in (await terminal.run("down", "--dir", folder)).output


@pytest.mark.smoke
async def test_as_json_a_refusal_is_one_object(network: NetworkUnderTest, terminal: Terminal) -> None:
    import json

    outcome = await terminal.run("wallet", *_genesis(network), "records", "--json")
    document = json.loads(outcome.output)
    assert (document["ok"], document["error"]["code"]) == (False, "WALLET_NOT_FOUND")
    assert outcome.exit_code == 3
