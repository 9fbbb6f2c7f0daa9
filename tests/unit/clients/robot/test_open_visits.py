"""What a robot remembers of open visits over a kill: counts by owner key, and not a word of whose they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from clients.robot.identity.sealed_file import seal_content
from clients.robot.recording import unclosed_visit_store
from clients.robot.recording.spool import Spool
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.counted import note
from tests.unit.clients.robot.test_spool import KEY, clip

ANN, BOB = b"\x02" + b"A" * 32, b"\x03" + b"B" * 32


def test_counts_survive_a_kill_at_any_moment(tmp_path: Path) -> None:
    path = tmp_path / "robot" / "open-visits"
    visits = UnclosedVisitStore(path, KEY)
    assert visits.counts == {}
    for owner, count in ((ANN, 1), (BOB, 1), (ANN, 2)):
        note(visits, owner, count)
        assert UnclosedVisitStore(path, KEY).counts == visits.counts
    visits.forget(BOB)
    visits.save()
    (path.parent / ".tmp-open-visits").write_bytes(b"half a fi")
    assert UnclosedVisitStore(path, KEY).counts == {ANN: 2}
    assert [file.name for file in path.parent.iterdir()] == ["open-visits"]


def test_the_file_shows_no_owner_key(tmp_path: Path) -> None:
    note(UnclosedVisitStore(tmp_path / "open-visits", KEY), ANN, 7)
    assert ANN[1:] not in (tmp_path / "open-visits").read_bytes()


@pytest.mark.parametrize(
    "change", [lambda data: data[:-1], lambda data: data[:-1] + bytes([data[-1] ^ 1]), lambda _: b""]
)
def test_a_changed_file_is_named_and_not_taken_for_an_empty_one(tmp_path: Path, change) -> None:
    path = tmp_path / "open-visits"
    note(UnclosedVisitStore(path, KEY), ANN, 7)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(BlockRobotError, match=r"SPOOL_DAMAGED.*open-visits"):
        UnclosedVisitStore(path, KEY)


def test_a_clip_is_counted_on_disk_once_it_is_spooled_and_saved_and_what_is_there_is_not_written_again(
    tmp_path: Path,
) -> None:
    path = tmp_path / "open-visits"
    visits = UnclosedVisitStore(path, KEY)
    visits.count(ANN, 1)
    visits.save()
    assert (visits.counts, path.exists()) == ({ANN: 1}, False), "a sealed clip is in the robot's memory alone"
    visits.spooled(ANN, "000000000001.clip")
    assert not path.exists()
    visits.save()
    first = path.read_bytes()
    visits.save()
    assert path.read_bytes() == first
    assert UnclosedVisitStore(path, KEY).counts == {ANN: 1}
    visits.lower(ANN)
    assert UnclosedVisitStore(path, KEY).counts == {ANN: 1}
    visits.save()
    assert UnclosedVisitStore(path, KEY).counts == {ANN: 0}


def test_a_clip_that_cannot_be_spooled_counts_as_missing(tmp_path: Path) -> None:
    visits = UnclosedVisitStore(tmp_path / "open-visits", KEY)
    visits.count(ANN, 1)
    visits.missed(ANN)
    visits.save()
    assert UnclosedVisitStore(tmp_path / "open-visits", KEY).counts == {ANN: 1}


class Life:
    """A robot's life, as far as spool and counts go: what it finds, and what it leaves when it is killed."""

    def __init__(self, folder: Path) -> None:
        self.visits = UnclosedVisitStore(folder / "open-visits", KEY)
        self.spool = Spool(folder / "spool", KEY)
        self.visits.recover_spooled(self.spool)

    def store(self, number: int, owner: bytes, *, is_saved: bool = True) -> str:
        """Seal and spool one clip, and count it, unless the robot is killed before."""
        self.visits.count(owner, self.visits.counts.get(owner, 0) + 1)
        name = self.spool.put(msgspec.structs.replace(clip(number), owner=owner))
        self.visits.spooled(owner, name)
        if is_saved:
            self.visits.save()
        return name


def test_what_a_killed_robot_had_spooled_and_not_counted_is_counted_once_by_the_next(tmp_path: Path) -> None:
    killed = Life(tmp_path)
    for number in (1, 2):
        killed.store(number, ANN)
    killed.spool.remove(killed.store(3, BOB))
    killed.store(4, ANN, is_saved=False)
    for _ in range(2):  # it may be killed again before it does anything
        life = Life(tmp_path)
        assert life.visits.counts == UnclosedVisitStore(tmp_path / "open-visits", KEY).counts == {ANN: 3, BOB: 1}
        assert life.visits.inherited == {ANN, BOB}


def test_the_first_clip_of_a_visit_is_taken_up_too_also_where_the_spools_numbers_began_again(tmp_path: Path) -> None:
    first = Life(tmp_path)
    for number in range(5):
        first.spool.remove(first.store(number, ANN))
    Life(tmp_path).store(6, BOB, is_saved=False)
    life = Life(tmp_path)
    assert (life.spool.names(), life.visits.counts) == (["000000000001.clip"], {ANN: 5, BOB: 1})
    assert BOB in life.visits.inherited, "whether it was announced that life did not know"


def test_a_clip_that_cannot_be_read_stops_no_robot_at_its_start(tmp_path: Path) -> None:
    killed = Life(tmp_path)
    (tmp_path / "spool" / killed.store(1, ANN, is_saved=False)).write_bytes(b"damaged")
    assert Life(tmp_path).visits.counts == {}


def test_a_thread_that_saves_sees_no_half_of_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A count and the number that it goes to belong together, whatever is spooled while an earlier state is saved."""
    visits = UnclosedVisitStore(tmp_path / "open-visits", KEY)
    visits.spooled(ANN, "000000000001.clip")

    def meanwhile(*arguments: Any) -> bytes:
        visits.spooled(ANN, "000000000002.clip")
        return seal_content(*arguments)

    monkeypatch.setattr(unclosed_visit_store, "seal_content", meanwhile)
    visits.save()
    monkeypatch.undo()
    assert UnclosedVisitStore(tmp_path / "open-visits", KEY).counts == {ANN: 1}
    visits.save()
    assert UnclosedVisitStore(tmp_path / "open-visits", KEY).counts == {ANN: 2}


def test_a_visit_that_goes_on_after_a_clip_was_dropped_stays_a_record_short(tmp_path: Path) -> None:
    """The pipeline counts what it seals; what was destroyed since was sealed too, and will never be a record."""
    path = tmp_path / "open-visits"
    visits = UnclosedVisitStore(path, KEY)
    note(visits, ANN, 1)
    visits.lower(ANN)
    note(visits, ANN, 2)
    note(visits, ANN, 3)
    visits.lower(ANN)
    note(visits, ANN, 4)
    assert visits.counts == UnclosedVisitStore(path, KEY).counts == {ANN: 2}
    visits.forget(ANN)
    visits.lower(ANN)
    assert visits.counts == {}
