"""What the segmentation makes of two people: apart, arm in arm, one before the other."""

from __future__ import annotations

import numpy as np
import pytest

from clients.robot.hiding.background import UNSEEN_MM, Background, empty_bank, learn_background
from clients.robot.hiding.cutouts import extract_encoded_cutout
from clients.robot.hiding.segmentation import PIECES_MAX_COUNT, segment
from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import parse_scenario
from clients.robot.synthetic.scenes import Stratum, draw_scene
from clients.sdk.pictures.rendition_picture import decode_depth_png
from consensus.errors import BlockRobotError

FOCAL_PX = 525.0


def scene(small_text: str, *places: tuple[float, float]) -> Renderer:
    """Return a full-size renderer of people who stand at the places (x, z) in metres."""
    head, _, person = small_text.partition("[[people]]")
    head = head.replace("width = 160", "width = 640").replace("height = 120", "height = 480")
    head = head.replace("focal_px = 131.0", f"focal_px = {FOCAL_PX}")
    people = ""
    for number, (x, z) in enumerate(places):
        path = f"path = [[0.0, {x}, {z}], [0.6, {x}, {z}]]"
        body = person.replace('"ann"', f'"p{number}"').replace("path = [[0.0, -0.4, 2.5], [0.6, 0.0, 2.2]]", path)
        people += "[[people]]" + body
    return Renderer(parse_scenario(head + people))


@pytest.fixture(scope="module")
def background(small_text: str) -> Background:
    renderer = scene(small_text)
    return learn_background([renderer.empty_frame(i) for i in range(9)])


def withhold_reasons(renderer: Renderer, background: Background) -> list[str]:
    return sorted(s.withhold_reason for s in segment(renderer.frame(1), background, FOCAL_PX).silhouettes)


def test_one_person_is_found_where_they_stand_and_none_in_an_empty_corridor(
    small_text: str, background: Background
) -> None:
    (found,) = segment(scene(small_text, (0.5, 3.0)).frame(1), background, FOCAL_PX).silhouettes
    assert found.withhold_reason == ""
    assert found.x_m == pytest.approx(0.5, abs=0.08)
    assert found.z_m == pytest.approx(3.0, abs=0.12)
    assert found.range_m == pytest.approx(3.05, abs=0.15)
    renderer = scene(small_text)
    assert [len(segment(renderer.empty_frame(i), background, FOCAL_PX).silhouettes) for i in range(20, 30)] == [0] * 10


def test_people_apart_are_no_trouble_and_only_who_stands_behind_is_occluded(
    small_text: str, background: Background
) -> None:
    assert withhold_reasons(scene(small_text, (-0.9, 2.3), (0.9, 3.6)), background) == ["", ""]
    assert withhold_reasons(scene(small_text, (0.0, 2.2), (0.35, 3.6)), background) == ["", "occluded"]


@pytest.mark.parametrize("gap_m", [0.35, 0.45, 0.55])
def test_people_arm_in_arm_are_merged(small_text: str, background: Background, gap_m: float) -> None:
    assert withhold_reasons(scene(small_text, (-gap_m / 2, 2.6), (gap_m / 2, 2.6)), background) == ["merged"]


@pytest.mark.parametrize("aid", ["wheelchair", "rollator", "stick"])
def test_an_aid_touches_nobody_and_belongs_to_who_uses_it(aid: Stratum) -> None:
    renderer = Renderer(draw_scene(3, aid))
    background = learn_background([renderer.empty_frame(i) for i in range(4)])
    truth = renderer.truth(30)
    segmented = segment(truth.depth, background, FOCAL_PX)
    assert segmented.labels is not None
    own = truth.labels[::2, ::2] == 1
    whose = max(segmented.silhouettes, key=lambda s: int(np.sum(own & (segmented.labels == s.label))))
    assert whose.withhold_reason == ""
    assert np.mean(segmented.labels[own & (truth.depth[::2, ::2] > 0)] == whose.label) > 0.8


def test_a_silhouettes_cut_stays_inside_its_own_pixels(small_text: str, background: Background) -> None:
    renderer = scene(small_text, (-0.25, 2.3), (0.45, 3.9))
    depth, truth = renderer.frame_with_truth(1)
    segmented = segment(depth, background, FOCAL_PX)
    near = min(segmented.silhouettes, key=lambda silhouette: silhouette.z_m)
    made = extract_encoded_cutout(depth, background, segmented, near)
    shown = decode_depth_png(made.pixels_png) > 0
    part = truth[made.y : made.y + made.height, made.x : made.x + made.width]
    assert np.count_nonzero(shown & (part == 2)) == 0
    assert np.count_nonzero(shown & (part == 1)) > 0.95 * np.count_nonzero((truth == 1) & (depth > 0))


@pytest.mark.parametrize("aside_m", [0.14, 0.20, 0.26])
def test_a_sliver_of_somebody_close_behind_is_not_taken_for_the_owners_edge(
    small_text: str, background: Background, aside_m: float
) -> None:
    """Too little of them is left to see for a silhouette: what is regrown must stop where depth jumps."""
    renderer = scene(small_text, (0.0, 1.8), (aside_m, 2.42))
    depth, truth = renderer.frame_with_truth(1)
    assert np.count_nonzero(truth == 2) > 600
    segmented = segment(depth, background, FOCAL_PX)
    near = min(segmented.silhouettes, key=lambda silhouette: silhouette.z_m)
    made = extract_encoded_cutout(depth, background, segmented, near)
    shown = decode_depth_png(made.pixels_png) > 0
    part = truth[made.y : made.y + made.height, made.x : made.x + made.width]
    assert np.count_nonzero(shown & (part == 2)) == 0
    assert np.count_nonzero(shown & (part == 1)) > 0.95 * np.count_nonzero((truth == 1) & (depth > 0))


def test_what_is_far_nearer_between_two_sampled_columns_is_not_taken_for_the_owners_edge() -> None:
    """Segmentation looks at every second column; the edge is regrown at full size."""
    empty = np.full((480, 640), 8_000, np.uint16)
    depth = empty.copy()
    depth[120:420, 280:360] = 3_000
    depth[200:300, 361] = 2_500  # a finger's breadth of somebody before them
    depth[300:400, 361] = 2_900
    segmented = segment(depth, learn_background([empty] * 3), FOCAL_PX)
    (person,) = segmented.silhouettes
    made = extract_encoded_cutout(depth, learn_background([empty] * 3), segmented, person)
    shown = decode_depth_png(made.pixels_png)
    assert not np.any(shown == 2_500)
    assert np.any(shown == 2_900)


def test_of_a_picture_of_crumbs_the_largest_are_looked_at_and_the_others_are_foreground_all_the_same() -> None:
    """Each piece is compared with each other one: a picture of thousands took seconds."""
    empty = np.full((480, 640), 65_000, np.uint16)
    half = np.zeros((240, 320), np.uint16)
    for number, top in enumerate(range(0, 235, 5)):
        for left in range(0, 314, 6):
            half[top : top + 4, left : left + 5] = 10_000 + 460 * (number % 40)
    crumbs = np.repeat(np.repeat(half, 2, 0), 2, 1)
    segmented = segment(crumbs, learn_background([empty] * 3), 20.0)
    assert len(segmented.silhouettes) <= PIECES_MAX_COUNT
    assert segmented.labels is not None
    assert np.count_nonzero(segmented.labels == -1) > np.count_nonzero(segmented.labels > 0)


def test_a_background_keeps_what_is_measured_and_marks_what_never_is() -> None:
    frames = [np.full((8, 8), 3_000, np.uint16) for _ in range(5)]
    for number, frame in enumerate(frames):
        frame[0, 0] = 0
        frame[1, 1] = 0 if number < 2 else 3_000 + number
        frame[2, 2] = 2_500 if number == 0 else 3_000
    background = learn_background(frames)
    assert background.depth[0, 0] == UNSEEN_MM
    assert 3_002 <= background.depth[1, 1] <= 3_004
    assert background.depth[2, 2] == 3_000


def test_a_background_of_nothing_is_refused_and_the_bank_names_each_by_its_hash() -> None:
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        learn_background([])
    mixed: list[Depth] = [np.ones((4, 4), np.uint16), np.ones((4, 5), np.uint16)]
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        learn_background(mixed)
    frames: list[Depth] = [np.full((8, 8), 1_000 + i, np.uint16) for i in range(3)]
    bank = empty_bank(frames)
    assert len({entry.background_id for entry in bank}) == 3
    assert np.array_equal(decode_depth_png(bank[2].png), frames[2])
