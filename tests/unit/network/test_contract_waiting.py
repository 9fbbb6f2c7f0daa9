"""Commands that change contracts wait until the change is final, and look for room first, in front of a consortium."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

import network.cli.contract.contract_waiting as contract_waiting
from contracts.lifecycle.registry import read_source
from network.cli.contract.contract_lifecycle_commands import OPEN_OF_ONE_MAX_COUNT, UPLOADS_MAX_COUNT
from tests.unit.contracts.system.consortium import Consortium, admin_of
from tests.unit.contracts.system.deploying import FAILING, VISITORS, VISITORS_2, upload
from tests.unit.network.test_contract_lifecycle_commands import answer, chain, refusal, run

__all__ = ["chain"]


@pytest.fixture
def blocks(chain: Consortium, monkeypatch: pytest.MonkeyPatch) -> Consortium:
    """The chain goes on by a block whenever somebody waits."""

    async def pause() -> None:
        await asyncio.sleep(0)
        chain.block([])

    monkeypatch.setattr(contract_waiting, "pause", pause)
    return chain


def propose(source: str, *more: str) -> str:
    Path("visitors.py").write_text(source, encoding="utf-8")
    return str(answer("propose", "visitors.py", "--as", "org-01", *more)["proposal"]["id"][:12])


def test_an_approval_waits_until_the_version_is_in_force(blocks: Consortium) -> None:
    spoken = run("approve", propose(VISITORS), "--as", "org-02")
    height = blocks.height
    assert spoken.stdout.splitlines() == [
        f"deploy visitors: decided at height {height - 1}, takes effect with block {height}.",
        "visitors version 1 is in force.",
        "Next step: blockrobot contract show visitors",
    ]
    assert f"Waiting for block {height} to be final; the newest final block is {height - 1}." in spoken.stderr
    told = answer("approve", propose(VISITORS_2, "--delay", "3"), "--as", "org-02")
    assert (told["state"], told["version"], told["due_height"]) == ("in force", 2, blocks.height)


def test_a_migration_that_fails_is_told_and_named_from_then_on(blocks: Consortium) -> None:
    run("approve", propose(VISITORS), "--as", "org-02")
    spoken = run("approve", propose(FAILING), "--as", "org-02")
    assert spoken.exit_code == 1
    failure = "TOO_EARLY: Not yet. (line 17)"
    assert f"visitors version 2 failed at block {blocks.height}: {failure}" in spoken.stderr
    assert "CONTRACT_CHANGE_FAILED. Next step: " in spoken.stderr


def test_a_disabling_is_waited_for_too(blocks: Consortium) -> None:
    run("approve", propose(VISITORS), "--as", "org-02")
    opened = answer("disable", "visitors", "--as", "org-01")["proposal"]["id"][:12]
    assert "visitors is disabled." in run("approve", opened, "--as", "org-02").stdout


def test_who_comes_too_late_is_told_when_it_was_decided(blocks: Consortium) -> None:
    opened = propose(VISITORS)
    height = answer("approve", opened, "--as", "org-02")["height"]
    late = run("approve", opened, "--as", "org-03")
    assert f"The proposal {opened} (deploy visitors) was decided at height {height}." in late.stderr
    opened = propose(VISITORS_2)
    run("withdraw", opened, "--as", "org-01")
    assert "(deploy visitors) was withdrawn at height" in run("approve", opened, "--as", "org-03").stderr


def test_what_is_far_ahead_or_never_final_is_not_waited_for(chain: Consortium, monkeypatch: pytest.MonkeyPatch) -> None:
    far = answer("approve", propose(VISITORS, "--delay", "5000"), "--as", "org-02")
    assert far["state"] is None
    monkeypatch.setattr(contract_waiting, "WAIT_MAX_S", 0.0)
    spoken = run("approve", propose(VISITORS_2), "--as", "org-02")
    assert spoken.exit_code == 0
    assert "is not final yet (the newest final block is" in spoken.stderr
    assert "takes effect with block" in spoken.stdout


def test_one_proposal_too_many_is_refused_before_its_source_pushes_another_out(chain: Consortium) -> None:
    opened = [propose(f"{VISITORS}# {number}\n") for number in range(OPEN_OF_ONE_MAX_COUNT)]
    before = chain.height
    Path("visitors.py").write_text(VISITORS_2, encoding="utf-8")
    spoken = run("propose", "visitors.py", "--as", "org-01")
    assert f"blockrobot contract withdraw {opened[0]} --as org-01" in spoken.stderr
    assert refusal("propose", "visitors.py", "--as", "org-01") == "GOVERNANCE_PROPOSALS_TOO_MANY"
    assert chain.height == before
    assert run("show", "visitors", "--proposal", opened[0], "--source").stdout == f"{VISITORS}# 0\n"
    run("withdraw", opened[0], "--as", "org-01")
    assert propose(VISITORS_2)


def test_an_upload_that_would_push_out_what_a_proposal_needs_is_refused(chain: Consortium) -> None:
    opened = propose(VISITORS)
    for number in range(UPLOADS_MAX_COUNT - 1):
        upload(chain, admin_of("org-01"), f"{VISITORS}# {number}\n")
    before = chain.height
    Path("visitors.py").write_text(VISITORS_2, encoding="utf-8")
    assert refusal("propose", "visitors.py", "--as", "org-01") == "GOVERNANCE_PROPOSALS_TOO_MANY"
    assert f"contract withdraw {opened} --as org-01" in run("propose", "visitors.py", "--as", "org-01").stderr
    assert chain.height == before


def test_the_limits_are_those_of_the_contracts() -> None:
    assert f"OPEN_OF_ONE_MAX_COUNT = {OPEN_OF_ONE_MAX_COUNT}\n" in read_source("membership")
    assert f"UPLOADS_MAX_COUNT = {UPLOADS_MAX_COUNT}\n" in read_source("lifecycle")
