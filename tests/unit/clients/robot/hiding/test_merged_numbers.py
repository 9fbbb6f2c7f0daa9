"""A frame that is withheld as merged says how large the silhouette was, and by which rule it is two people's."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from clients.robot.cli.run_report import summary_lines
from clients.robot.hiding.background import Background, learn_background
from clients.robot.hiding.companion import shipped_model
from clients.robot.hiding.frame_redactor import FrameRedactor, WithheldFrame
from clients.robot.hiding.withhold_reason import MergedBy, MergedEvidence, WithholdReason
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.sensing.sensor_events import Depth, Facing, Frame, Sighting
from tests.unit.clients.robot.run_summaries import FRAMES, summary_of

SHAPE = (480, 640)
WALL_MM = 9_500
FOCAL_PX = 525.0


def boards(z_m: float, height_m: float, *breadths_m: float) -> Depth:
    """Return a wall and before it flat boards, the narrow above the broad, in equal parts of the height."""
    depth = np.full(SHAPE, WALL_MM, dtype=np.uint16)
    tall = round(height_m / len(breadths_m) * FOCAL_PX / z_m)
    top = round((SHAPE[0] - tall * len(breadths_m)) / 2)
    for number, breadth_m in enumerate(breadths_m):
        half = round(breadth_m * FOCAL_PX / z_m / 2)
        rows = slice(top + number * tall, top + (number + 1) * tall)
        depth[rows, SHAPE[1] // 2 - half : SHAPE[1] // 2 + half] = round(z_m * 1000)
    return depth


@pytest.fixture(scope="module")
def wall() -> Background:
    return learn_background([np.full(SHAPE, WALL_MM, dtype=np.uint16)] * 4)


def withheld(wall: Background, pictures: list[Depth], z_m: float) -> list[WithheldFrame]:
    redactor = FrameRedactor(wall, focal_px=FOCAL_PX)
    outputs = []
    for number, picture in enumerate(pictures):
        at = 100 * number
        if number % 5 == 0:
            outputs += redactor.push_sighting("ann", Sighting(at, at, "", 1, Facing.FRONT, -50.0, z_m, 0.1))
        outputs += redactor.push_frame(Frame(at, number, picture))
    outputs += redactor.flush()
    return [output for output in outputs if isinstance(output, WithheldFrame)]


@pytest.mark.parametrize(
    ("z_m", "height_m", "breadths_m", "by", "limit"),
    [
        (3.0, 1.7, (1.0,), MergedBy.AREA, 1.3),
        (8.0, 1.7, (0.7,), MergedBy.AREA, 1.05),
        (8.0, 1.6, (0.2, 0.9, 0.2, 0.2), MergedBy.BREADTH, 0.78),
        (3.0, 1.6, (0.25, 0.9, 0.9, 0.9), MergedBy.SHAPE, round(shipped_model().suspect, 2)),
    ],
)
def test_the_rule_is_named_with_its_limit_and_the_silhouettes_size(
    wall: Background, z_m: float, height_m: float, breadths_m: tuple[float, ...], by: MergedBy, limit: float
) -> None:
    found = withheld(wall, [boards(z_m, height_m, *breadths_m)] * 20, z_m)
    assert {each.reason for each in found} == {WithholdReason.MERGED}
    evidence = found[-1].evidence
    assert isinstance(evidence, MergedEvidence)
    assert (evidence.by, round(evidence.limit, 2)) == (by, limit)
    assert evidence.area_m2 == pytest.approx(height_m * sum(breadths_m) / len(breadths_m), rel=0.06)
    assert evidence.range_m == pytest.approx(z_m, rel=0.1)
    assert evidence.excess > 0


def test_one_person_just_after_two_is_said_to_be_withheld_for_what_was_before(wall: Background) -> None:
    two, one = boards(3.0, 1.7, 1.0), boards(3.0, 1.7, 0.25, 0.45, 0.4, 0.35)
    alone = withheld(wall, [one] * 20, 3.0)
    after = withheld(wall, [two] * 10 + [one] * 2, 3.0)
    assert WithholdReason.MERGED not in {each.reason for each in alone}
    told = {each.sequence: each.evidence for each in after if each.reason is WithholdReason.MERGED}
    first = told[10]
    assert isinstance(first, MergedEvidence)
    assert first.by is MergedBy.BEFORE


def test_the_last_lines_say_it_of_the_silhouette_that_was_nearest_to_one_person() -> None:
    statistics = RunStatistics(window_ms=5_000)
    for area_m2 in (1.9, 1.42, 1.6):
        statistics.add_merged("tag-1", MergedEvidence(MergedBy.AREA, 1.3, 2.553, area_m2, 0.81, 3.04))
    statistics.add_merged("tag-2", MergedEvidence(MergedBy.SHAPE, -1.035, 2.4, 0.86, 1.02, 3.1))
    lines = list(summary_lines(replace(summary_of(FRAMES), merged=statistics.summarise_merged())))
    assert lines[1] == (
        "tag-1, 3 merged: 1.42 m² of silhouette, 0.81 m broad, 3.04 m away; 1.3 m² is the limit: larger than one person is."
    )
    assert lines[2].startswith(
        "tag-2, 1 merged: 0.86 m² of silhouette, 1.02 m broad, 3.1 m away; log-odds of two people 2.4, -1.03 is the limit: "
    )
