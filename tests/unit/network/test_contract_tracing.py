"""Tracing a final transaction: the chain is executed again, and what nodes serve is believed only if it fits."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

import network.cli.governance.governance_signer as governance_signer
from clients.sdk.chain.receipts import FinalReceipt, final_receipt
from clients.sdk.connections import NodeAddress
from consensus.chain.block import (
    HEADER_VERSION,
    Block,
    Header,
    Receipt,
    compute_receipts_root,
    compute_transactions_root,
    genesis_certificate,
)
from consensus.chain.genesis import genesis_to_json
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from contracts.execution.contract_machine import ContractMachine
from contracts.worker.sandbox import REQUIRED_PARTS
from network.cli.contract.contract_commands import contract
from network.contracts import contract_tracing
from network.contracts.contract_tracing import SandboxedTracer, trace_transaction
from tests.unit.contracts.system.consortium import Consortium, admin_of
from tests.world.ward import answer_block

NODE = NodeAddress("node-01", "http://127.0.0.1:1")


class ServedChain:
    """Real blocks of real calls, one block a list of calls, served as a client of a node gets them."""

    def __init__(self, *blocks: list[tuple[str, ...]]) -> None:
        self.consortium = Consortium()
        self.genesis = self.consortium.genesis
        self.machine = ContractMachine.of_genesis(self.genesis)
        self.blocks: list[Block] = [self.genesis.block()]
        self.receipts: dict[bytes, FinalReceipt] = {}
        for calls in blocks:
            self.extend([self.consortium.sign(admin_of("org-01"), *call) for call in calls])

    def extend(self, transactions: list[Transaction]) -> None:
        state, height = self.consortium.state, len(self.blocks)
        result = self.machine.verify(state, height, self.consortium.time_ms, transactions)
        state.absorb(result.writes, result.page_writes, result.state_root)
        header = Header(
            version=HEADER_VERSION,
            chain_id=self.genesis.chain_id,
            epoch=0,
            height=height,
            round=height,
            parent_id=self.blocks[-1].block_id,
            qc=genesis_certificate(self.genesis.block_id),
            tc=None,
            producer=0,
            timestamp_ms=self.consortium.time_ms,
            transactions_root=compute_transactions_root([one.txid for one in transactions]),
            receipts_root=compute_receipts_root(result.receipts),
            state_root=result.state_root,
            next_schedule_hash=None,
            gas_used=result.gas_used,
            is_closing=False,
        )
        block = Block(encode(header), bytes(64), tuple(one.wire for one in transactions))
        self.blocks.append(block)
        for index, receipt in enumerate(result.receipts):
            self._note(receipt, block, index)

    def _note(self, receipt: Receipt, block: Block, index: int) -> None:
        height, time_ms = block.header.height, block.header.timestamp_ms
        self.receipts[receipt.txid] = final_receipt(
            receipt, height=height, index=index, block_id=block.block_id, timestamp_ms=time_ms
        )

    def txid(self, height: int, index: int) -> bytes:
        found = [one for one in self.receipts.values() if (one.height, one.index) == (height, index)]
        return found[0].txid

    # What a client does

    async def __aenter__(self) -> ServedChain:
        return self

    async def __aexit__(self, *exception: object) -> None:
        return None

    async def wait_final(self, txid: bytes, timeout_ms: int) -> FinalReceipt:
        if txid not in self.receipts:
            raise BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME")
        return self.receipts[txid]

    async def with_any_node(self, work: Any) -> Any:
        return await work(NODE)

    async def ask_node(self, node: NodeAddress, method: str, path: str, *, key: Any) -> bytes:
        return answer_block(self.blocks[int(path.removeprefix("/v1/blocks/"))])


PROPOSE = ("settings", "propose")


@pytest.fixture
def served() -> ServedChain:
    """Three blocks; the last holds a proposal, one of an unknown setting, and one of a value that cannot be."""
    return ServedChain(
        [(*PROPOSE, "heartbeat_ms", "9000")],
        [],
        [(*PROPOSE, "heartbeat_ms", 9_001), (*PROPOSE, "colour", 1), (*PROPOSE, "heartbeat_ms", 9_001)],
    )


async def trace(served: ServedChain, height: int, index: int) -> Any:
    return await trace_transaction(served, admin_of("org-01"), served.txid(height, index))  # type: ignore[arg-type]


async def test_a_failed_transaction_is_executed_again_line_by_line(served: ServedChain) -> None:
    found = await trace(served, 3, 1)
    assert (found.receipt.code, found.trace.code) == ("SETTING_UNKNOWN", "SETTING_UNKNOWN")
    text = found.trace.text()
    assert text.startswith('settings.propose("colour", 1) by 0x')
    assert 'name = "colour", value = 1' in text
    assert text.endswith("SETTING_UNKNOWN: There is no such setting.")
    assert found.trace.steps[-1].line == found.receipt.line


async def test_what_came_before_it_in_its_block_counts(served: ServedChain) -> None:
    """The same call twice: the first opens a proposal, and the second sees it."""
    first, second = await trace(served, 3, 0), await trace(served, 3, 2)
    assert (first.trace.code, second.trace.code) == (first.receipt.code, second.receipt.code)
    assert "membership" in {step.contract for step in first.trace.steps}
    assert (await trace(served, 1, 0)).trace.gas_used == served.receipts[served.txid(1, 0)].gas_used


async def test_blocks_that_do_not_fit_are_not_believed(served: ServedChain) -> None:
    honest = list(served.blocks)
    other = msgspec.structs.replace(honest[2].header, state_root=bytes(32))
    served.blocks[2] = Block(encode(other), honest[2].signature, honest[2].transactions)
    with pytest.raises(BlockRobotError, match="Block 2 gives another state"):
        await trace(served, 3, 1)
    served.blocks[2] = honest[1]
    with pytest.raises(BlockRobotError, match="does not follow"):
        await trace(served, 3, 1)
    header = msgspec.structs.replace(honest[3].header, timestamp_ms=1)
    served.blocks[2:] = [honest[2], Block(encode(header), bytes(64), honest[3].transactions)]
    with pytest.raises(BlockRobotError, match="not the one that was proved"):
        await trace(served, 3, 1)


def test_the_chain_is_executed_in_the_sandbox(served: ServedChain) -> None:
    with SandboxedTracer(served.genesis, served.receipts[served.txid(3, 1)]) as tracer:
        wanted = REQUIRED_PARTS if sys.platform == "linux" else frozenset()
        assert {part.name for part in tracer.parts if part.had} >= wanted


def test_a_process_that_ends_is_told_with_a_code(served: ServedChain, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract_tracing, "TRACER_MODULE", "no_such_module")
    with (
        pytest.raises(BlockRobotError, match="ended") as failed,
        SandboxedTracer(served.genesis, served.receipts[served.txid(3, 1)]),
    ):
        raise AssertionError("it cannot begin")
    assert failed.value.code == "CONTRACT_WORKER_FAILED"


def test_the_commands_process_cannot_execute_a_contract() -> None:
    """What executes is imported by the sandboxed process alone."""
    text = Path(contract_tracing.__file__).read_text(encoding="utf-8")
    assert not re.search(r"contracts\.(?:execution|vm|state)|node\.replaying|kit\.(?:chain|recorder)", text)


def test_the_command_shows_lines_and_values(
    served: ServedChain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "network" / "organisations" / "org-01"
    place.mkdir(parents=True)
    (place / "admin.key").write_bytes(admin_of("org-01").secret)
    (tmp_path / "network" / "genesis.json").write_text(genesis_to_json(served.genesis), encoding="utf-8")
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.setattr(governance_signer, "open_pinned_client", lambda _genesis, _path: served)
    shown = CliRunner().invoke(contract, ["trace", served.txid(3, 1).hex()])
    assert "settings.propose" in shown.output
    assert "failed at line" in shown.output
    document = json.loads(CliRunner().invoke(contract, ["trace", served.txid(3, 1).hex(), "--json"]).stdout)
    assert (document["ok"], document["code"], document["height"]) == (True, "SETTING_UNKNOWN", 3)
    assert document["steps"][-1]["line"] == document["line"]
    assert "64 hexadecimal digits" in CliRunner().invoke(contract, ["trace", "12"]).stderr
    unknown = CliRunner().invoke(contract, ["trace", "00" * 32])
    assert (unknown.exit_code, "TRANSACTION_NOT_FINAL_IN_TIME" in unknown.stderr) == (5, True)
