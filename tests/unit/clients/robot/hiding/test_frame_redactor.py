"""The published run at ten frames a second, seen by the redactor and judged against the renderer's truth."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from clients.robot.hiding.background import learn_background
from clients.robot.hiding.frame_redactor import FrameRedactor, KeptFrame, Output, WithheldFrame
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.pairing.tag_pairing import Decision
from clients.robot.sensing.sensor_events import Depth, Facing, Frame, Sighting
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario, published_run_1
from clients.robot.synthetic.tag_readings import readings
from consensus.errors import BlockRobotError

EVERY = 2
UNTIL_S = 19.0
OWNERS = {"patient-a": 1, "patient-b": 2}


@dataclass(frozen=True)
class Clip:
    """Frames with their truth, empty frames and sightings of the published run."""

    scenario: Scenario
    empty: list[Depth]
    frames: list[Frame]
    truth: dict[int, np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]
    sightings: list[tuple[str, Sighting]]


@pytest.fixture(scope="module")
def clip() -> Clip:
    scenario = published_run_1()
    renderer = Renderer(scenario)
    frames, truth = [], {}
    for index in range(0, int(UNTIL_S * scenario.frame_rate), EVERY):
        depth, labels = renderer.frame_with_truth(index)
        frames.append(Frame(round(index * 1000 / scenario.frame_rate), index, depth))
        truth[index] = labels
    seen = []
    for reading in readings(scenario):
        at = round(reading.at_s * 1000)
        facing, rssi = reading.facing, reading.rssi_dbm
        seen.append(
            (reading.alias, Sighting(at, at, "", reading.antenna, facing, rssi, reading.distance_m, reading.sigma_m))
        )
    return Clip(scenario, [renderer.empty_frame(i) for i in range(12)], frames, truth, seen)


def play(clip: Clip, sightings: list[tuple[str, Sighting]], *, known: bool = True) -> tuple[list[Output], int]:
    """Return all outputs and the largest number of frames that were held."""
    redactor, outputs, held = FrameRedactor(learn_background(clip.empty)), [], 0
    waiting = sorted(sightings, key=lambda item: item[1].first_seen_ms)
    for frame in clip.frames:
        while waiting and waiting[0][1].first_seen_ms <= frame.captured_at_ms:
            outputs += redactor.push_sighting(*waiting.pop(0), known=known)
        outputs += redactor.push_frame(frame)
        held = max(held, redactor.held_count)
    return outputs + redactor.flush(), held


@pytest.fixture(scope="module")
def outcome(clip: Clip) -> list[Output]:
    return play(clip, clip.sightings)[0]


def pixels(kept: KeptFrame) -> np.ndarray[tuple[int, ...], np.dtype[np.uint16]]:
    image = cv2.imdecode(np.frombuffer(kept.cutout.pixels_png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image, dtype=np.uint16)


def test_every_frame_is_decided_once_in_time_order_and_at_most_three_tenths_are_withheld(
    clip: Clip, outcome: list[Output]
) -> None:
    decisions = [output for output in outcome if isinstance(output, Decision)]
    assert sorted(d.sequence for d in decisions) == [frame.sequence for frame in clip.frames]
    verdicts = Counter((o.sequence, o.alias) for o in outcome if not isinstance(o, Decision))
    assert verdicts == Counter((d.sequence, alias) for d in decisions for alias in d.owners)
    for alias in OWNERS:
        times = [o.captured_at_ms for o in outcome if not isinstance(o, Decision) and o.alias == alias]
        assert len(times) > 10
        assert times == sorted(times)
    verdicts = [output for output in outcome if not isinstance(output, Decision)]
    withheld = [output for output in verdicts if isinstance(output, WithheldFrame)]
    assert len(withheld) <= 0.30 * len(verdicts)
    of_a = [output for output in verdicts if output.alias == "patient-a"]
    assert sum(isinstance(output, KeptFrame) for output in of_a) >= 0.97 * len(of_a)
    early = [o for o in outcome if isinstance(o, WithheldFrame) and o.alias == "patient-b" and o.captured_at_ms < 5_500]
    assert early
    assert {output.reason for output in early} == {WithholdReason.NO_SILHOUETTE}


def test_no_rendition_shows_anybody_else(clip: Clip, outcome: list[Output]) -> None:
    foreign = total = 0
    for kept in (output for output in outcome if isinstance(output, KeptFrame)):
        truth = clip.truth[kept.sequence]
        box = truth[
            kept.cutout.y : kept.cutout.y + kept.cutout.height, kept.cutout.x : kept.cutout.x + kept.cutout.width
        ]
        shown = pixels(kept) > 0
        foreign += np.count_nonzero(shown & (box != 0) & (box != OWNERS[kept.alias]))
        total += np.count_nonzero(shown)
    assert total > 1_000_000
    assert foreign <= 0.001 * total


def test_renditions_show_nearly_all_of_their_owner_unchanged(clip: Clip, outcome: list[Output]) -> None:
    frames = {frame.sequence: frame for frame in clip.frames}
    shares = []
    for kept in [output for output in outcome if isinstance(output, KeptFrame)][::9]:
        depth, truth = frames[kept.sequence].depth, clip.truth[kept.sequence]
        part = (
            slice(kept.cutout.y, kept.cutout.y + kept.cutout.height),
            slice(kept.cutout.x, kept.cutout.x + kept.cutout.width),
        )
        image = pixels(kept)
        assert np.array_equal(image[image > 0], depth[part][image > 0])
        own = (truth == OWNERS[kept.alias]) & (depth > 0)
        shares.append(np.count_nonzero((image > 0) & own[part]) / np.count_nonzero(own))
    assert np.mean(shares) > 0.97
    assert min(shares) > 0.80


def test_a_bearer_who_is_not_in_the_picture_gets_nobody_elses(clip: Clip) -> None:
    rng = np.random.default_rng(3)
    hidden = []
    for step in range(24):
        at = 500 * step
        distance = 2.4 + float(rng.normal(0, 0.3))
        hidden.append(("patient-c", Sighting(at, at, "", 2, Facing.BACK, -50.0, distance, 0.3)))
    outputs, _ = play(clip, hidden)
    verdicts = [output for output in outputs if not isinstance(output, Decision)]
    assert len(verdicts) > 200
    assert {type(output) for output in verdicts} == {WithheldFrame}


def test_without_distance_nothing_is_shown_and_the_reason_is_said(clip: Clip) -> None:
    blind = [(alias, replace(s, distance_m=None, sigma_m=None)) for alias, s in clip.sightings if alias == "patient-a"]
    outputs, _ = play(clip, blind)
    reasons = Counter(o.reason for o in outputs if isinstance(o, WithheldFrame))
    assert not [output for output in outputs if isinstance(output, KeptFrame)]
    assert set(reasons) <= {WithholdReason.NO_DISTANCE, WithholdReason.MERGED}
    assert reasons[WithholdReason.NO_DISTANCE] >= 0.98 * reasons.total()


def test_unknown_tags_get_no_verdicts(clip: Clip) -> None:
    outputs, _ = play(clip, clip.sightings, known=False)
    assert {type(output) for output in outputs} == {Decision}


def test_two_tags_on_one_person_show_neither_bearer(clip: Clip) -> None:
    mine = [s for alias, s in clip.sightings if alias == "patient-a"]
    outputs, _ = play(clip, [("one", s) for s in mine] + [("two", s) for s in mine])
    kept = Counter(o.alias for o in outputs if isinstance(o, KeptFrame))
    assert kept["two"] == 0
    assert kept["one"] == 0


def test_memory_holds_no_more_than_the_buffer(clip: Clip) -> None:
    _, held = play(clip, clip.sightings)
    assert held <= 10_100 / 1000 * clip.scenario.frame_rate / EVERY + 2


def test_a_frame_out_of_order_or_twice_is_answered_once(clip: Clip) -> None:
    redactor = FrameRedactor(learn_background(clip.empty))
    redactor.push_sighting("patient-a", clip.sightings[0][1])
    outputs = redactor.push_frame(Frame(3_000, 0, clip.frames[0].depth))
    outputs += redactor.push_frame(Frame(2_900, 1, clip.frames[0].depth))
    outputs += redactor.flush()
    late = [output for output in outputs if isinstance(output, WithheldFrame) and output.sequence == 1]
    assert [output.reason for output in late] == [WithholdReason.DISORDERED]
    redactor = FrameRedactor(learn_background(clip.empty))
    redactor.push_sighting("patient-a", clip.sightings[0][1])
    redactor.push_frame(clip.frames[0])
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        redactor.push_frame(clip.frames[0])
    assert len([output for output in redactor.flush() if isinstance(output, WithheldFrame)]) == 1


def test_a_frame_of_another_size_is_refused(clip: Clip) -> None:
    redactor = FrameRedactor(learn_background(clip.empty))
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        redactor.push_frame(Frame(0, 0, np.zeros((100, 100), np.uint16)))
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        redactor.push_frame(Frame(0, 0, np.zeros((480, 640), np.float32)))  # type: ignore[arg-type]


def test_somebody_cut_off_by_the_pictures_edge_means_that_nobody_is_alone(clip: Clip) -> None:
    mine = [(alias, sighting) for alias, sighting in clip.sightings if alias == "patient-a"]
    alone = {o.sequence for o in play(clip, mine)[0] if isinstance(o, KeptFrame) and o.alone}
    assert alone
    frames = []
    for frame in clip.frames:
        depth = frame.depth.copy()
        depth[200:440, :22] = 2_600
        frames.append(replace(frame, depth=depth))
    assert not [o for o in play(replace(clip, frames=frames), mine)[0] if isinstance(o, KeptFrame) and o.alone]
