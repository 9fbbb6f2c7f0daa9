"""Sharing with a member by her short handle, on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from consensus.members.handles import encode_short
from tests.unit.clients.wallet.test_sharing_commands import People


@pytest.fixture
def people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> People:
    return People(tmp_path, monkeypatch)


def test_a_short_handle_leads_to_the_same_member_and_a_mistyped_one_to_nobody(people: People, tmp_path: Path) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    doctor, told = people.doctor, people.told(people.doctor, "handle")
    assert told["short"] == encode_short(doctor.store.content.handle)
    assert people.run(doctor, "handle").output.split()[0] == told["short"]
    share = [record_id.hex(), "--purpose", "care", "--for", "7d", "--yes", "--as", "Dr Weber"]
    wrong = told["short"][:-1] + ("q" if told["short"][-1] != "q" else "p")
    refused = people.run(people.ward.wallet, "share", *share, "--with", wrong)
    assert (refused.exit_code, "HANDLE_MISTYPED" in refused.output) == (2, True)
    nobody = people.run(people.ward.wallet, "share", *share, "--with", encode_short(bytes(32)))
    assert "SHARE_WITH_NON_MEMBER" in nobody.output
    (tmp_path / "doctor.txt").write_text(f"{told['short']}\n")
    shared = people.told(people.ward.wallet, "share", *share, "--with", f"@{tmp_path}/doctor.txt")
    assert shared["handle"] == told["handle"]
