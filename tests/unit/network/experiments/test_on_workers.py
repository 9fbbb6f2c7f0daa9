"""What a worker sends of an experiment: its folder, up to a size, and nothing beside it."""

from __future__ import annotations

import io
import tarfile
import time
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from network.experiments import on_workers
from network.experiments.on_workers import only_one_on_this_machine, pack_results, unpack_results


def test_a_folder_comes_back_as_it_was(tmp_path: Path) -> None:
    sent, came = tmp_path / "sent", tmp_path / "came"
    (sent / "wallets").mkdir(parents=True)
    (sent / "summary.json").write_text("{}")
    (sent / "wallets" / "patient-a.words").write_text("words")
    (sent / "wallets" / "patient-a.words").chmod(0o600)
    came.mkdir()
    unpack_results(pack_results(sent), came)
    assert sorted(path.relative_to(came).as_posix() for path in came.rglob("*")) == [
        "summary.json",
        "wallets",
        "wallets/patient-a.words",
    ]
    assert (came / "wallets" / "patient-a.words").read_text() == "words"
    assert (came / "wallets" / "patient-a.words").stat().st_mode & 0o777 == 0o600


def test_more_than_the_bound_is_neither_sent_nor_taken(tmp_path: Path) -> None:
    (tmp_path / "sent").mkdir()
    (tmp_path / "sent" / "log").write_bytes(bytes(1001))
    with pytest.raises(BlockRobotError, match="1001 bytes"):
        pack_results(tmp_path / "sent", max_bytes=1000)
    with pytest.raises(BlockRobotError) as refusal:
        unpack_results(pack_results(tmp_path / "sent"), tmp_path / "came", max_bytes=1000)
    assert refusal.value.code == "CLUSTER_RESULT_FOREIGN"
    assert not (tmp_path / "came" / "log").exists()


@pytest.mark.parametrize(
    ("name", "links_to"),
    [("../beside", ""), ("link", "/etc/passwd"), ("link", "../../beside"), ("link", "file"), ("hard", "file")],
)
def test_what_would_lie_elsewhere_is_not_taken_and_no_link(tmp_path: Path, name: str, links_to: str) -> None:
    """A file with many links to it is unpacked as many files, and some versions of Python follow links out."""
    packed, came, member = io.BytesIO(), tmp_path / "came", tarfile.TarInfo(name)
    came.mkdir()
    if links_to:
        member.type, member.linkname = tarfile.LNKTYPE if name == "hard" else tarfile.SYMTYPE, links_to
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        archive.addfile(member)
    with pytest.raises(BlockRobotError) as refusal:
        unpack_results(packed.getvalue(), came)
    assert refusal.value.code == "CLUSTER_RESULT_FOREIGN"
    assert [*tmp_path.iterdir(), *came.iterdir()] == [came]


def test_the_second_on_a_machine_waits_for_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looked at whenever the second would wait: it is there as soon as the first is gone, and not before."""
    monkeypatch.setattr(on_workers, "_LOCK_NAME", "\0blockrobot-experiment-of-a-test")
    first, waited = only_one_on_this_machine(), list[str]()

    def wait(_: float) -> None:
        waited.append("the first has it")
        if len(waited) == 2:
            first.__exit__(None, None, None)

    monkeypatch.setattr(time, "sleep", wait)
    first.__enter__()
    with only_one_on_this_machine():
        assert len(waited) == 2


def test_where_nothing_can_be_locked_it_is_said_and_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(on_workers, "_LOCK_NAME", str(tmp_path / "no-such-folder" / "lock"))
    with pytest.raises(FileNotFoundError), only_one_on_this_machine():
        pass
