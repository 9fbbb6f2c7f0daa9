"""A nurse records an empty ward, looks, approves; what was not looked at, was changed or has expired is not used."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from clients.robot.backgrounds.background_banks import (
    DAY_MS,
    PUBLISHED_MAX_COUNT,
    approve_scene,
    approved_frames,
    check_empty,
    get_scene,
    list_scenes,
    moved_px,
    published_frames,
    record_scene,
)
from clients.robot.cli.background_commands import background
from clients.robot.cli.robot_choice import RobotPlace
from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario
from clients.sdk.pictures.depth_colours import LEGEND_HEIGHT_PX
from consensus.errors import BlockRobotError

NOW_MS = 1_700_000_000_000


def empty_frames(count: int = 12) -> list[Depth]:
    rng = np.random.default_rng(5)
    return [np.rint(rng.normal(4000, 20, (120, 160))).astype(np.uint16) for _ in range(count)]


def with_someone_leaving() -> list[Depth]:
    frames = empty_frames()
    for frame in frames[:4]:
        frame[20:110, 50:90] = 2000
    return frames


def code_of(call: object, *arguments: object, **named: object) -> str:
    assert callable(call)
    with pytest.raises(BlockRobotError) as refused:
        call(*arguments, **named)
    return refused.value.code


@pytest.mark.parametrize("present", [range(1, 8), range(8), range(20, 23), range(44, 45), range(30, 45)])
@pytest.mark.parametrize("out_of_range", [False, True])
def test_a_passer_by_in_a_few_frames_of_many_is_refused(tmp_path: Path, present: range, out_of_range: bool) -> None:
    frames = empty_frames(45)
    for number, frame in enumerate(frames):
        if out_of_range:
            frame[10:115, 30:110] = 0
        if number in present:
            frame[20:110, 50:70] = 2000
    assert code_of(record_scene, tmp_path, "ward-3", frames, NOW_MS) == "BACKGROUND_INVALID"
    assert code_of(check_empty, frames) == "BACKGROUND_INVALID"


def test_the_preview_shows_every_frame_that_is_published_and_what_changed(tmp_path: Path) -> None:
    frames = empty_frames(45)
    frames[3][10:15, 10:15] = 1000
    scene = record_scene(tmp_path, "ward-3", frames, NOW_MS)
    shown = cv2.imread(str(scene.preview))
    assert shown is not None
    assert shown.shape[:2] == (2 * 120 + LEGEND_HEIGHT_PX, 5 * 160)
    assert len(published_frames(frames)) == PUBLISHED_MAX_COUNT
    changed = shown[120:240, 4 * 160 :]
    background = changed[60, 60]
    assert 20 <= np.count_nonzero((changed != background).any(axis=2)) <= 40


def test_a_bank_is_used_once_a_person_has_approved_it(tmp_path: Path) -> None:
    frames = empty_frames()
    scene = record_scene(tmp_path, "ward-3", frames, NOW_MS)
    assert (scene.state(NOW_MS), scene.frame_count) == ("recorded", 12)
    assert scene.preview.stat().st_size > 0
    assert code_of(approved_frames, tmp_path, "ward-3", NOW_MS) == "BACKGROUND_NOT_APPROVED"
    approve_scene(tmp_path, "ward-3", by="A. Nurse", days=30, now_ms=NOW_MS)
    assert all((a == b).all() for a, b in zip(approved_frames(tmp_path, "ward-3", NOW_MS), frames, strict=True))


def test_an_approval_expires(tmp_path: Path) -> None:
    record_scene(tmp_path, "ward-3", empty_frames(), NOW_MS)
    approve_scene(tmp_path, "ward-3", by="A. Nurse", days=1, now_ms=NOW_MS)
    assert approved_frames(tmp_path, "ward-3", NOW_MS + DAY_MS - 1)
    assert code_of(approved_frames, tmp_path, "ward-3", NOW_MS + DAY_MS) == "BACKGROUND_EXPIRED"


def test_a_frame_that_was_changed_after_the_approval_is_not_used(tmp_path: Path) -> None:
    scene = record_scene(tmp_path, "ward-3", empty_frames(), NOW_MS)
    approve_scene(tmp_path, "ward-3", by="A. Nurse", days=1, now_ms=NOW_MS)
    (scene.folder / "003.png").write_bytes((scene.folder / "004.png").read_bytes())
    assert get_scene(tmp_path, "ward-3").state(NOW_MS) == "changed"
    assert code_of(approved_frames, tmp_path, "ward-3", NOW_MS) == "BACKGROUND_NOT_APPROVED"


def test_recording_again_needs_a_new_approval(tmp_path: Path) -> None:
    record_scene(tmp_path, "ward-3", empty_frames(20), NOW_MS)
    approve_scene(tmp_path, "ward-3", by="A. Nurse", days=1, now_ms=NOW_MS)
    again = record_scene(tmp_path, "ward-3", empty_frames(9), NOW_MS + 1)
    assert (again.state(NOW_MS + 1), again.frame_count) == ("recorded", 9)
    assert sorted(path.name for path in again.folder.glob("0*.png"))[-1] == "008.png"


def test_someone_who_walks_out_of_the_empty_scene_is_noticed(tmp_path: Path) -> None:
    assert moved_px(empty_frames()) < 20
    assert moved_px(with_someone_leaving()) > 800
    assert code_of(record_scene, tmp_path, "ward-3", with_someone_leaving(), NOW_MS) == "BACKGROUND_INVALID"
    assert list_scenes(tmp_path) == []


@pytest.mark.parametrize("name", ["", "../ward", "ward 3", "a" * 41, "wärd"])
def test_a_viewpoint_cannot_be_named_out_of_its_folder(tmp_path: Path, name: str) -> None:
    assert code_of(record_scene, tmp_path, name, empty_frames(), NOW_MS) == "USAGE_INVALID"


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    assert code_of(approved_frames, tmp_path, "ward-3", NOW_MS) == "BACKGROUND_NOT_FOUND"
    assert code_of(record_scene, tmp_path, "ward-3", empty_frames(3), NOW_MS) == "BACKGROUND_INVALID"
    scene = record_scene(tmp_path, "ward-3", empty_frames(), NOW_MS)
    assert code_of(approve_scene, tmp_path, "ward-3", by=" ", days=1, now_ms=NOW_MS) == "BACKGROUND_INVALID"
    (scene.folder / "003.png").unlink()
    assert code_of(get_scene, tmp_path, "ward-3") == "BACKGROUND_INVALID"
    (scene.folder / "scene.json").write_bytes(b"{")
    assert code_of(get_scene, tmp_path, "ward-3") == "BACKGROUND_INVALID"


@pytest.mark.parametrize("count", [1, 3, 30])
def test_the_noise_of_a_small_camera_is_no_movement(small_scenario: Scenario, count: int) -> None:
    renderer = Renderer(small_scenario)
    check_empty([renderer.empty_frame(number) for number in range(count)])


def test_people_in_frames_said_to_be_empty_are_refused(small_scenario: Scenario) -> None:
    renderer = Renderer(small_scenario)
    frames = [renderer.empty_frame(number) for number in range(12)]
    frames[5] = renderer.frame(2)
    assert code_of(check_empty, frames) == "BACKGROUND_INVALID"


def test_an_approval_without_a_terminal_says_what_to_give(tmp_path: Path) -> None:
    """Nobody can be asked there whether somebody has looked."""
    record_scene(tmp_path, "ward-3", empty_frames(), NOW_MS)
    arguments = ["approve", "ward-3", "--by", "A. Nurse"]
    place = RobotPlace(tmp_path, tmp_path / "genesis.json")
    done = CliRunner().invoke(background, arguments, obj=place)
    assert done.exit_code == 2
    assert "look at it, and give --yes" in done.output
    assert str(get_scene(tmp_path, "ward-3").preview) in done.output.replace("\n", "")
    assert not get_scene(tmp_path, "ward-3").approved_by
    assert (
        CliRunner()
        .invoke(background, [*arguments, "--yes"], obj=RobotPlace(tmp_path, tmp_path / "genesis.json"))
        .exit_code
        == 0
    )
    assert get_scene(tmp_path, "ward-3").approved_by == "A. Nurse"


def test_recording_again_deletes_no_picture_of_somebodys_and_follows_no_link(tmp_path: Path) -> None:
    folder = record_scene(tmp_path, "ward-3", empty_frames(20), NOW_MS).folder
    (folder / "ward.png").write_bytes(b"mine")
    record_scene(tmp_path, "ward-3", empty_frames(9), NOW_MS + 1)
    assert (folder / "ward.png").read_bytes() == b"mine"
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    assert code_of(record_scene, tmp_path, "ward-3", empty_frames(20), NOW_MS + 2) == "FILE_EXISTS"
    assert len(list((tmp_path / "elsewhere").glob("0*.png"))) == 9
