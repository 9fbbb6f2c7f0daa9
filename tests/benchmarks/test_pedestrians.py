"""Real pedestrians, in colour without depth: what the robot keeps of them, and that nobody is shown to anybody else."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from consensus.errors import BlockRobotError
from network.cli.main import main
from network.lab.pedestrians.evaluate import judge_pedestrians, keep_without_depth
from network.lab.pedestrians.film import FILM, read_film
from network.lab.pedestrians.marks import find_people, is_marked_film, marked_people

STRETCH = range(215, 375)


@pytest.mark.system_packages
def test_on_a_stretch_of_the_film_each_bearer_gets_herself_and_nobody_sees_anybody_else(tmp_path: Path) -> None:
    picture = tmp_path / "shown.png"
    result = judge_pedestrians(seed=3, tags=8, frames=STRETCH, picture=picture)
    figures = result.figures
    assert result.ok, figures
    assert figures.film_frames == len(STRETCH)
    assert figures.people_shown >= 2
    assert figures.pictures_kept >= 60
    assert (figures.others_visible, figures.pictures_of_another) == (0, 0)
    assert figures.pictures_looked_at >= 4
    assert figures.others_visible_without_hiding >= 4 * figures.pictures_looked_at
    assert figures.silhouettes_taken_for_several_people > 0.3 * figures.silhouettes, "most who walk here are in company"
    assert figures.pictures_kept_without_depth == 0, "colour alone is kept for nobody"
    assert figures.frames_with_the_bearer_alone == 0, "nobody ever had the place for herself: no whole frame is kept"
    shown = cv2.imread(str(picture))
    assert shown is not None
    assert shown.shape[0] == 2 * 288 * figures.people_shown


@pytest.mark.system_packages
def test_the_film_has_as_many_frames_as_it_should_and_its_empty_scene_holds_nobody_who_was_marked() -> None:
    film = read_film()
    assert (len(film.frames), film.shape) == (795, (576, 768))
    assert keep_without_depth(film) == 0
    for frame, boxes in marked_people().items():
        for x, y, width, height in boxes:
            box = (slice(y, y + height), slice(x, x + width))
            differs = cv2.absdiff(film.frames[frame][box], film.empty[box]).max(axis=2) > 28
            assert np.mean(differs) > 0.12, f"nobody is in {x}, {y} of frame {frame}"


@pytest.mark.smoke
def test_the_judge_by_eye_finds_who_is_to_be_seen_beside_the_owner() -> None:
    people = ((100, 100, 30, 80), (140, 100, 30, 80), (300, 200, 30, 80))
    shown = np.zeros((576, 768), dtype=bool)
    shown[102:178, 102:128] = True
    assert find_people(shown, people) == find_people(shown | False, people)
    assert (find_people(shown, people).owner, find_people(shown, people).others) == (0, ())
    shown[150:160, 150:160] = True
    assert find_people(shown, people).others == (1,)
    shown[:] = False
    shown[102:178, 102:128] = shown[102:178, 142:168] = True
    assert find_people(shown, people).owner is None, "two halves: nobody can be named the owner"
    assert find_people(shown, people).others == (0, 1)


@pytest.mark.system_packages
def test_people_are_marked_in_one_film_alone(tmp_path: Path) -> None:
    assert is_marked_film(FILM)
    other = tmp_path / "other.avi"
    other.write_bytes(FILM.read_bytes() + b"\0")
    assert not is_marked_film(other)


@pytest.mark.smoke
def test_a_picture_that_could_not_be_written_is_refused_before_the_film_is_played(tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match="no folder"):
        judge_pedestrians(film_file=tmp_path / "gone.avi", picture=tmp_path / "nowhere" / "shown.png")


@pytest.mark.smoke
def test_without_the_film_the_refusal_says_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match="apt install opencv-doc"):
        read_film(tmp_path / "gone.avi")
    told = CliRunner().invoke(main, ["bench", "pedestrians", "--film", str(tmp_path / "gone.avi"), "--json"])
    assert told.exit_code == 1
    assert (
        json.loads(told.output.splitlines()[-1] if told.output.startswith("r") else told.output)["error"]["code"]
        == "FILE_UNUSABLE"
    )
    assert str(FILM) != str(tmp_path / "gone.avi")
