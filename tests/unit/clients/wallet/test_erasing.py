"""Erasing: what is asked, in what portions, and that nothing is called erased before every custodian said so."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest
from click.testing import CliRunner

from clients.sdk.known_nodes import KnownCustodian
from clients.wallet.commands import erase_commands
from clients.wallet.commands.erase_commands import erasures
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.erasure_text import custodian_names, erasure_lines, erasure_row
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.records.erasure_status import ErasureProgress, describe_erasure
from clients.wallet.store.keystore import Keystore, KnownVisit
from consensus.errors import BlockRobotError
from consensus.limits import ERASURE_OVERDUE_AFTER_MS
from consensus.state.erasure import REQUEST, ErasureReceiptRow, ErasureRow
from tests.virtual_time import run_virtual
from tests.world.dicts import World


async def own_visit(world: World) -> KnownVisit:
    world.open_visit()
    return (await world.wallet.scan())[-1]


Receipts = dict[bytes, ErasureReceiptRow]


def said(frames: int = 0, remains: str = "nothing", until_ms: int = 0, time_ms: int = 0) -> ErasureReceiptRow:
    return ErasureReceiptRow(frames, remains, until_ms, bytes(32), time_ms)


def put_erasure(
    world: World, erasure_id: bytes, status: Any, receipts: Receipts, frames: Sequence[int] = (), time_ms: int = 0
) -> None:
    custodians = [b"a" * 33, b"b" * 33]
    row = ErasureRow(b"o" * 33, [bytes(16)], list(frames), custodians, receipts, status, time_ms)
    world.put(REQUEST, row, erasure_id)


async def test_whole_records_are_asked_for_by_the_owner_key(world: World) -> None:
    visit = await own_visit(world)
    ids = [bytes([number] * 16) for number in range(3)]
    (erasure_id,) = await ErasureClient(world.wallet).request(visit, ids, [])
    assert world.network.calls == [(visit.owner, "erasure", "request", [ids, []])]
    assert Keystore.open(world.store._path, "tea").content.asked_erasures == [erasure_id]


async def test_more_records_than_one_call_takes_go_in_several(world: World) -> None:
    visit = await own_visit(world)
    ids = [number.to_bytes(16, "big") for number in range(150)]
    erasures = await ErasureClient(world.wallet).request(visit, ids, [])
    parts = [arguments[0] for _, _, _, arguments in world.network.calls]
    assert [len(part) for part in parts] == [64, 64, 22]
    assert [record_id for part in parts for record_id in part] == ids
    assert len(set(erasures)) == 3


async def test_single_frames_are_erased_of_one_record_only(world: World) -> None:
    visit = await own_visit(world)
    await ErasureClient(world.wallet).request(visit, [bytes(16)], [0, 3])
    assert world.network.calls[-1][3] == [[bytes(16)], [0, 3]]
    with pytest.raises(BlockRobotError, match=r"^REQUEST_INVALID:"):
        await ErasureClient(world.wallet).request(visit, [bytes(16), bytes([1] * 16)], [0])


async def test_a_request_that_the_chain_refuses_is_not_noted_as_asked(world: World) -> None:
    visit = await own_visit(world)
    world.network.refusal = "RECORD_ERASED"
    with pytest.raises(BlockRobotError):
        await ErasureClient(world.wallet).request(visit, [bytes(16)], [])
    assert world.store.content.asked_erasures == []


async def test_a_report_is_complete_only_when_the_chain_says_so(world: World) -> None:
    visit = await own_visit(world)
    put_erasure(world, b"e" * 32, "requested", {b"a" * 33: said()})
    report = await ErasureClient(world.wallet).report(visit, b"e" * 32)
    assert not report.complete
    assert list(report.state.receipts) == [b"a" * 33]
    put_erasure(world, b"e" * 32, "complete", {b"a" * 33: said(), b"b" * 33: said()})
    assert (await ErasureClient(world.wallet).report(visit, b"e" * 32)).complete


async def test_an_erasure_that_the_chain_does_not_know_is_not_found(world: World) -> None:
    visit = await own_visit(world)
    with pytest.raises(BlockRobotError, match=r"^NOT_FOUND:"):
        await ErasureClient(world.wallet).report(visit, b"e" * 32)


def test_waiting_ends_with_the_last_receipt(tmp_path: Path) -> None:
    world = World(tmp_path)
    answers = iter(["requested", "requested", "complete"])
    first = world.network.state_values

    async def changing(keys: Any, key: Any) -> Any:
        if any(map(REQUEST.owns, keys)):
            put_erasure(world, b"e" * 32, next(answers), {})
        return await first(keys, key)

    async def main() -> None:
        visit = await own_visit(world)
        world.network.state_values = changing  # type: ignore[method-assign]
        (report,) = await ErasureClient(world.wallet).wait_complete([(visit, [b"e" * 32])])
        assert report.complete

    run_virtual(main())


def test_waiting_in_vain_says_how_many_receipts_are_missing(tmp_path: Path) -> None:
    world = World(tmp_path)

    async def main() -> None:
        visit = await own_visit(world)
        put_erasure(world, b"e" * 32, "requested", {b"a" * 33: said()})
        with pytest.raises(BlockRobotError) as caught:
            await ErasureClient(world.wallet).wait_complete([(visit, [b"e" * 32])])
        assert caught.value.code == "ERASURE_NOT_CONFIRMED"
        assert caught.value.detail.startswith("1 ")

    run_virtual(main())


ASKED_MS = 1_800_000_000_000
NAMES = {b"a" * 33: "node-1 of ward", b"b" * 33: "node-2 of lab"}


async def _described(world: World, receipts: Receipts, *, age_ms: int, frames: list[int]) -> ErasureProgress:
    visit = await own_visit(world)
    put_erasure(world, b"e" * 32, "complete" if len(receipts) == 2 else "requested", receipts, frames, ASKED_MS)
    report = await ErasureClient(world.wallet).report(visit, b"e" * 32)
    return describe_erasure(report, ASKED_MS + age_ms)


async def test_who_has_confirmed_and_who_is_overdue_is_said_by_name(world: World) -> None:
    told = said(12, time_ms=ASKED_MS + 400)
    for age_ms, overdue in ((ERASURE_OVERDUE_AFTER_MS, False), (ERASURE_OVERDUE_AFTER_MS + 1, True)):
        erasure = await _described(world, {b"a" * 33: told}, age_ms=age_ms, frames=[])
        assert [word.overdue for word in erasure.custodians] == [False, overdue]
        lines = "\n".join(erasure_lines(erasure, NAMES))
        assert "1 record: not erased everywhere yet." in lines
        assert "node-1 of ward confirmed" in lines
        assert "12 keys destroyed." in lines
        assert ("node-2 of lab is OVERDUE" in lines) == overdue
        assert ("node-2 of lab has not confirmed yet" in lines) != overdue


async def test_what_remains_of_erased_pictures_is_said_until_when(world: World) -> None:
    told = said(2, "commitment-leaves", ASKED_MS + 1, ASKED_MS)
    erasure = await _described(world, {b"a" * 33: told, b"b" * 33: told}, age_ms=10**9, frames=[0, 1])
    lines = erasure_lines(erasure, NAMES)
    assert "2 pictures of a record: erased everywhere." in lines[0]
    remains = "what remains is check numbers, which prove the other pictures and show nothing, until"
    assert all(remains in line for line in lines[1:])
    described = erasure_row(erasure, NAMES)
    assert [word.overdue for word in described.custodians] == [False, False]
    assert described.custodians[0].destroyed_frames == 2


async def test_a_custodian_without_a_name_is_told_by_its_key(world: World) -> None:
    visit = await own_visit(world)
    put_erasure(world, b"e" * 32, "requested", {})
    report = await ErasureClient(world.wallet).report(visit, b"e" * 32)
    erasure = describe_erasure(report, ASKED_MS)
    assert erasure_row(erasure, {}).custodians[0].name == f"custodian {(b'a' * 33).hex()[:12]}"


async def test_in_portuguese_the_same_is_said_with_what_remains_and_who_is_late(world: World) -> None:
    nothing = said(1, time_ms=ASKED_MS)
    leaves = said(2, "commitment-leaves", ASKED_MS + 1, ASKED_MS)
    names = {b"a" * 33: "node-1 de ward"}
    erasure = await _described(world, {b"a" * 33: nothing}, age_ms=10**9, frames=[])
    head, first, second = erasure_lines(erasure, names, "pt")
    assert head.endswith("  1 gravação: ainda não apagado em todo o lado.")
    assert "node-1 de ward confirmou em " in first
    assert first.endswith(": 1 chave destruída.")
    assert second.startswith(f"  depositário {(b'b' * 33).hex()[:12]} está ATRASADO.")
    late = await _described(world, {b"a" * 33: leaves}, age_ms=0, frames=[0, 1])
    head, first, second = erasure_lines(late, names, "pt")
    assert "2 imagens de uma gravação: " in head
    assert "2 chaves destruídas; o que lá fica: números de controlo" in first
    assert second.endswith(" ainda não confirmou.")
    assert erasure_row(erasure, NAMES).custodians[0].name == "node-1 of ward"


def test_the_command_speaks_portuguese_and_its_json_stays_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, told = World(tmp_path), []
    erasure = run_virtual(_described(world, {}, age_ms=0, frames=[]))
    custodians = (KnownCustodian("node-1", "ward", b"a" * 33), KnownCustodian("node-2", "lab", b"b" * 33, 40))
    wallet = SimpleNamespace(network=SimpleNamespace(known_custodians=custodians))

    async def find(_wallet: Wallet, _now_ms: int) -> list[ErasureProgress]:
        return list(told)

    def run_with_wallet(_: click.Context, action: Callable[[Any], Awaitable[Any]]) -> Any:
        return asyncio.run(action(wallet))  # type: ignore[arg-type]

    monkeypatch.setattr(erase_commands, "find_erasures", find)
    monkeypatch.setattr(erase_commands, "run_with_wallet", run_with_wallet)
    english = json.loads(CliRunner().invoke(erasures, ["--json"]).output)
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    assert "Não pediu para apagar nada." in CliRunner().invoke(erasures, []).output
    assert json.loads(CliRunner().invoke(erasures, ["--json"]).output) == english
    told.append(erasure)
    assert "node-1 de ward ainda não confirmou." in CliRunner().invoke(erasures, []).output
    (row,) = json.loads(CliRunner().invoke(erasures, ["--json"]).output)["erasures"]
    assert [word["name"] for word in row["custodians"]] == list(NAMES.values())
    assert custodian_names(wallet) == NAMES  # type: ignore[arg-type]
