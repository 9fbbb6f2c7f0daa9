"""What a robot remembers of open visits over a kill: counts by owner key, and not a word of whose they are."""

from __future__ import annotations

from pathlib import Path

import pytest

from clients.robot.open_visits import OpenVisits
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.test_spool import KEY

ANN, BOB = b"\x02" + b"A" * 32, b"\x03" + b"B" * 32


def test_counts_survive_a_kill_at_any_moment(tmp_path: Path) -> None:
    path = tmp_path / "robot" / "open-visits"
    visits = OpenVisits(path, KEY)
    assert visits.counts == {}
    for owner, count in ((ANN, 1), (BOB, 1), (ANN, 2)):
        visits.note(owner, count)
        assert OpenVisits(path, KEY).counts == visits.counts
    visits.forget(BOB)
    visits.save()
    (path.parent / ".tmp-open-visits").write_bytes(b"half a fi")
    assert OpenVisits(path, KEY).counts == {ANN: 2}
    assert [file.name for file in path.parent.iterdir()] == ["open-visits"]


def test_the_file_shows_no_owner_key(tmp_path: Path) -> None:
    OpenVisits(tmp_path / "open-visits", KEY).note(ANN, 7)
    assert ANN[1:] not in (tmp_path / "open-visits").read_bytes()


@pytest.mark.parametrize(
    "change", [lambda data: data[:-1], lambda data: data[:-1] + bytes([data[-1] ^ 1]), lambda _: b""]
)
def test_a_changed_file_is_named_and_not_taken_for_an_empty_one(tmp_path: Path, change) -> None:
    path = tmp_path / "open-visits"
    OpenVisits(path, KEY).note(ANN, 7)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(BlockRobotError, match=r"SPOOL_DAMAGED.*open-visits"):
        OpenVisits(path, KEY)


def test_a_count_is_on_disk_once_it_is_saved_and_what_is_there_is_not_written_again(tmp_path: Path) -> None:
    path = tmp_path / "open-visits"
    visits = OpenVisits(path, KEY)
    visits.count(ANN, 1)
    assert (visits.counts, path.exists()) == ({ANN: 1}, False)
    visits.save()
    first = path.read_bytes()
    visits.save()
    assert path.read_bytes() == first
    assert OpenVisits(path, KEY).counts == {ANN: 1}
    visits.lower(ANN)
    assert OpenVisits(path, KEY).counts == {ANN: 1}
    visits.save()
    assert OpenVisits(path, KEY).counts == {ANN: 0}


def test_a_visit_that_goes_on_after_a_clip_was_dropped_stays_a_record_short(tmp_path: Path) -> None:
    """The pipeline counts what it seals; what was destroyed since was sealed too, and will never be a record."""
    path = tmp_path / "open-visits"
    visits = OpenVisits(path, KEY)
    visits.note(ANN, 1)
    visits.lower(ANN)
    visits.note(ANN, 2)
    visits.note(ANN, 3)
    visits.lower(ANN)
    visits.note(ANN, 4)
    assert visits.counts == OpenVisits(path, KEY).counts == {ANN: 2}
    visits.forget(ANN)
    visits.lower(ANN)
    assert visits.counts == {}
