"""The files that a look leaves: named by the numbers that commands take, and told of where they are of an earlier look."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from clients.robot.recording.sealing import VisitChain
from clients.wallet.commands import view_commands
from clients.wallet.presentation import album
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE
from clients.wallet.records.contact_sheet import Tile, draw_sheet
from clients.wallet.records.picture_files import delete_frames
from tests.world.commands import People


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def erase(people: People, visit: VisitChain, record_id: bytes, indexes: Sequence[int] = ()) -> None:
    """Have pictures of a record (all if none is named) erased on the chain and at the custodians."""
    asyncio.run(people.ward.erase(visit, [record_id], indexes))
    for index in indexes:
        people.ward.drop(record_id, index)


def flat(output: str) -> str:
    return "".join(output.split())


def test_the_number_in_a_files_name_is_the_one_to_erase_its_picture_by(people: People, tmp_path: Path) -> None:
    """The robot counts over the whole visit and from 0: its frame is in the name too, behind the number."""
    ward, ann = people.ward, people.ward.wallet
    _, (_, second) = ward.record_visit(2)
    before, after = tmp_path / "before" / second.hex(), tmp_path / "after" / second.hex()
    people.told(ann, "view", second.hex(), "--out", before.parent, "--no-sheet")
    pictures = ["picture-0001.frame-00000003", "picture-0002.frame-00000004"]
    assert names(before) == [f"{name}{suffix}" for name in pictures for suffix in (".depth.png", ".png")]
    (asked,) = people.told(ann, "erase", second.hex(), "--frames", "2", "--yes")["erasures"]
    (erased,) = ward.chain.value("erasure", b"erasure/" + bytes.fromhex(asked["erasure_id"]))["frames"]
    ward.drop(second, erased)
    people.told(ann, "view", second.hex(), "--out", after.parent, "--no-sheet")
    assert names(after) == [f"{pictures[0]}.depth.png", f"{pictures[0]}.png"]


def test_a_ctrl_c_says_how_much_is_written_and_how_to_get_the_rest(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[object] = []
    write = view_commands.write_pictures

    async def stop_at_the_second(*arguments: Any) -> Any:
        looks.append(arguments)
        if len(looks) == 2:
            raise KeyboardInterrupt
        return await write(*arguments)

    people.ward.record_visit(2)
    monkeypatch.setattr(view_commands, "write_pictures", stop_at_the_second)
    out = tmp_path / "pictures"
    stopped = people.run(people.ward.wallet, "view", "--out", out, "--no-sheet")
    assert stopped.exit_code == 1
    (record,) = out.iterdir()
    assert flat(f"Stopped. {len(names(record))} files are written in {out}.") in flat(stopped.output)


def test_what_is_shared_bears_the_owners_numbers_and_is_deleted_again(people: People, tmp_path: Path) -> None:
    ward, doctor = people.ward, people.doctor
    _, (_, second) = ward.record_visit(2)
    people.share(second, "--yes")
    (row,) = people.told(ward.wallet, "shares")["shares"]
    people.told(doctor, "look", row["grant_id"], "--out", tmp_path / "shared")
    folder = tmp_path / "shared" / second.hex()
    assert names(folder)[0] == "picture-0001.frame-00000003.depth.png"
    (folder / "letter.txt").touch()
    assert [path.name for path in delete_frames(folder)] == ["letter.txt"]
    assert names(folder) == ["letter.txt"]


def test_sheets_and_the_terminal_number_each_picture(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the sheet of a visit a number alone could be of any record: there the record stands beside it."""
    drawn: list[list[str]] = []

    def spy(tiles: Sequence[Tile], title: str, captions: Sequence[str]) -> bytes:
        drawn.append([caption.rsplit("  ", 1)[0] for caption in captions])
        return draw_sheet(tiles, title, captions)

    monkeypatch.setattr(album, "draw_sheet", spy)
    _, records = people.ward.record_visit(2)
    people.told(people.ward.wallet, "view", "--out", tmp_path / "all")
    first, second = (record_id.hex()[:12] for record_id in records)
    assert drawn == [["1", "2"], ["1", "2"], [f"1 ({first})", f"2 ({first})", f"1 ({second})", f"2 ({second})"]]


def test_a_second_look_says_nothing_where_nothing_is_left_of_the_first(people: People, tmp_path: Path) -> None:
    _, records = people.ward.record_visit(2)
    out = tmp_path / "v0"
    for again in (False, True):
        told = people.told(people.ward.wallet, "view", "--out", out)
        assert (again, told["earlier"]) == (again, [])
    (out / records[0].hex() / "notes.txt").touch()
    assert people.told(people.ward.wallet, "view", records[0].hex(), "--out", out)["earlier"] == []
    assert "earlier" not in people.run(people.ward.wallet, "view", "--out", out).output


def test_pictures_of_an_earlier_look_that_were_erased_since_are_named_and_not_deleted(
    people: People, tmp_path: Path
) -> None:
    ward, ann, out = people.ward, people.ward.wallet, tmp_path / "v0"
    visit, (first, second) = ward.record_visit(2)
    people.told(ann, "view", "--out", out)
    folder = out / second.hex()
    (folder / "mine.png").touch()
    erase(people, visit, second, [1])
    said = people.run(ann, "view", second.hex(), "--out", out, "--no-show").output
    left = ["animation.gif", "picture-0002.frame-00000004.depth.png", "picture-0002.frame-00000004.png"]
    assert flat(f"In {folder} are still 3 files of an earlier look") in flat(said)
    assert all(flat(name) in flat(said) for name in left)
    assert "mine.png" not in said
    whole = f"visit-{visit.owner.hex()[:12]}"
    assert flat(f"{whole}-contact-sheet.png") in flat(said), "the visit's sheet shows the erased picture too"
    assert set(left) <= set(names(folder)), "they are hers to delete"
    told = people.told(ann, "view", "--out", out)["earlier"]
    assert told == [str(folder / name) for name in left], "the visit's sheets are of this look now"
    assert people.told(ann, "view", first.hex(), "--out", out)["earlier"] == []


def test_a_record_that_was_erased_since_is_named_by_a_look_at_all_and_sheets_by_one_without(
    people: People, tmp_path: Path
) -> None:
    ward, ann, out = people.ward, people.ward.wallet, tmp_path / "v0"
    visit, (first, second) = ward.record_visit(2)
    people.told(ann, "view", "--out", out)
    erase(people, visit, second)
    prefix = f"visit-{visit.owner.hex()[:12]}"
    sheets = [out / f"{prefix}-animation.gif", out / f"{prefix}-contact-sheet.png"]
    everything = sorted((out / second.hex()).iterdir())
    assert people.told(ann, "view", "--out", out)["earlier"] == [str(path) for path in (*everything, *sheets)]
    own = [out / first.hex() / name for name in ("animation.gif", "contact-sheet.png")]
    assert people.told(ann, "view", first.hex(), "--out", out, "--no-sheet")["earlier"] == [str(path) for path in own]


def test_of_many_files_and_folders_some_are_named_and_all_are_counted(people: People, tmp_path: Path) -> None:
    ward, ann, out = people.ward, people.ward.wallet, tmp_path / "v0"
    ward.record_visit(1)
    for number in range(8):
        folder = out / f"{number:032x}"
        folder.mkdir(parents=True)
        for frame in range(9):
            (folder / f"picture-{frame + 1:04d}.frame-{frame:08d}.png").touch()
    said = flat(people.run(ann, "view", "--out", out, "--no-show").output)
    assert said.count("arestill9files") == 5
    assert said.count("picture-") == 5 * 4
    assert "27morearein3foldersbeside" in said
    assert len(people.told(ann, "view", "--out", out)["earlier"]) == 72


def test_a_look_at_what_was_shared_names_what_is_left_of_an_earlier_one(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward, doctor, out = people.ward, people.doctor, tmp_path / "shared"
    visit, (first, second) = ward.record_visit(2)
    asyncio.run(ward.share(doctor))
    grant = people.told(ward.wallet, "shares")["shares"][0]["grant_id"]
    assert people.told(doctor, "look", grant, "--out", out)["earlier"] == []
    erase(people, visit, second, [0])
    left = sorted((out / second.hex()).iterdir())
    assert people.told(doctor, "look", grant, "--out", out)["earlier"] == [str(path) for path in left]
    assert people.told(doctor, "look", grant, first.hex(), "--out", out)["earlier"] == []
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    said = people.run(doctor, "look", grant, "--out", out).output
    assert "4 ficheiros de uma consulta anterior" in " ".join(said.split())
