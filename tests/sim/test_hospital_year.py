"""A tiny hospital's days on real contracts, ledger and custodians: what has to hold does, and what is wrong is found."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from contracts.execution.contract_machine import ContractMachine
from network.cli.main import main
from network.lab.year.month_checks import check_month
from network.lab.year.out_folder import FIGURES_FILE, MARK, REPORT_FILE, reserved_out
from network.lab.year.plan import Event, Kind, YearOptions
from network.lab.year.run_year import YearRun, run_year
from network.provisioning import node_backup
from network.provisioning.network_files import HALF_DONE

TINY = YearOptions(days=3, members=12, robots=2, custodians=2, seed=4)


def test_a_tiny_hospital_keeps_what_it_promises_and_reports_it(tmp_path: Path) -> None:
    out = tmp_path / "year"
    asked = ["--days", "3", "--members", "12", "--robots", "2", "--custodians", "2", "--seed", "4", "--out", str(out)]
    result = CliRunner().invoke(main, ["lab", "year", *asked, "--json"])
    answer = json.loads(result.stdout)
    assert result.exit_code == 0, answer["failures"]
    assert answer["failures"] == []
    happened, (month,), end = answer["happened"], answer["months"], answer["end"]
    for what in ("visits", "looks", "shares", "erasures asked for", "keys rotated", "robots replaced", "visits denied"):
        assert happened[what] > 0, what
    assert month["records"] == happened["records"] == month["kept"] + month["erased"]
    assert month["erased"] > happened["records erased"], "some expired by themselves"
    assert month["erase_keys"] > 0
    assert all(seconds > 0 for seconds in month["seconds_a_day"].values())
    assert end["audits"] > 0
    assert end["audit_entries"] > happened["visits"]
    assert end["hunted_records"] > 0
    assert end["clips_fetched"] > 0, "what came after the backup"
    page = (out / REPORT_FILE).read_text(encoding="utf-8")
    assert answer["head"][:16] in page
    assert page.count("<svg") == 4
    assert json.loads((out / FIGURES_FILE).read_text(encoding="utf-8"))["head"] == answer["head"]


async def test_the_same_seed_makes_the_same_chain_and_another_seed_another(tmp_path: Path) -> None:
    short = TINY._replace(days=2, members=4)
    heads = [
        (await run_year(options, tmp_path / str(number))).head
        for number, options in enumerate((short, short, short._replace(seed=5)))
    ]
    assert heads[0] == heads[1] != heads[2]


async def test_a_custodian_that_keeps_what_is_erased_or_loses_what_is_kept_is_found(tmp_path: Path) -> None:
    run = YearRun(TINY._replace(days=1), tmp_path / "year", lambda _text: None)
    async with run.opened():
        await run.begin()
        await run.play_day()
        assert run.troubles == []
        assert await check_month(run.hospital, run.chain, run.custodians) == []
        first = run.custodians.places[0]
        record_id = next(iter(run.hospital.visits.values())).record_ids[0]
        (place, *_) = await first.store.frame_places([record_id])
        first.keys.destroy([place.slot])
        run.hospital.counts["shares"] += 1
        troubles = await check_month(run.hospital, run.chain, run.custodians)
    assert [each for each in troubles if "grants" in each]
    assert [each for each in troubles if each.startswith("the scrub of node-1 is not clean") and "corrupted=[(" in each]
    assert [each for each in troubles if each.startswith("node-1 holds")]
    assert not [each for each in troubles if "node-2" in each]


async def test_a_call_that_the_chain_refuses_is_a_failure(tmp_path: Path) -> None:
    run = YearRun(TINY._replace(days=1), tmp_path / "year", lambda _text: None)
    async with run.opened():
        await run.begin()
        stranger = run.hospital.officer.keys.identity
        await run.play([], [run.chain.sign(stranger, "identity", "revoke", bytes(32))])
    assert [each for each in run.troubles if "HANDLE_UNKNOWN" in each]


async def test_what_is_planned_for_something_that_was_refused_is_a_failure_and_ends_nothing(tmp_path: Path) -> None:
    run = YearRun(TINY._replace(days=1), tmp_path / "year", lambda _text: None)
    async with run.opened():
        await run.begin()
        kinds: tuple[Kind, ...] = ("revoke_grant", "look", "restrict", "setting")
        await run.play([run.hospital.tell(Event(0, kind, 999)) for kind in kinds])
        await run.play_day()
    assert [each.split(" of what is not there: ")[0] for each in run.troubles] == list(kinds[:3])
    assert run.hospital.counts["settings changed"] == 1
    assert run.hospital.counts["visits"] > 0


async def test_a_call_that_comes_into_no_block_is_named_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = ContractMachine.build

    def without_revocations(*place: Any, **options: Any) -> Any:
        *where, calls = place
        return build(*where, [call for call in calls if call.body.entry != "revoke"], **options)

    run = YearRun(TINY._replace(days=1), tmp_path / "year", lambda _text: None)
    async with run.opened():
        await run.begin()
        monkeypatch.setattr(ContractMachine, "build", without_revocations)
        await run.play([run.hospital.tell(Event(0, "revoke_member", 0))])
        height = run.chain.height
        await run.play([run.hospital.tell(Event(0, "withdraw", 1))])
    assert [each for each in run.troubles if "identity.revoke" in each] == run.troubles != []
    assert (height, run.hospital.counts["consents withdrawn"]) == (run.chain.height - 1, 1)


def test_a_year_that_was_killed_in_the_middle_of_its_backup_takes_its_folder_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "year"
    child = os.fork()
    if not child:
        monkeypatch.setattr(node_backup, "make_snapshot_folder", lambda *_: os.kill(os.getpid(), signal.SIGKILL))
        try:
            with reserved_out(out):
                asyncio.run(run_year(TINY._replace(days=1, members=4), out))
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert list(out.glob(f".*.{HALF_DONE}/*/keys/*.key"))
    with reserved_out(out):
        assert [path.name for path in out.iterdir()] == [MARK]


@pytest.mark.long
@pytest.mark.timeout(600)
async def test_a_month_of_a_small_hospital(tmp_path: Path) -> None:
    """Two ends of a month: what was searched for in the first is searched for again in the second."""
    answer = await run_year(YearOptions(days=32, members=40, robots=3, custodians=3, seed=2), tmp_path / "year")
    assert answer.failures == []
    assert [month.days for month in answer.months] == [30, 32]
    for what in ("restrictions lifted", "shares ended early", "consents given again", "settings changed"):
        assert answer.happened[what] > 0, what
