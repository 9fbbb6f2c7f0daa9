"""When a person was alone with the robot, and when nobody can say so."""

from __future__ import annotations

from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import KeptFrame, WithheldFrame
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.pairing.tag_pairing import Decision
from clients.robot.recording.occupancy import OccupancyMonitor

CUT = EncodedCutout(0, 0, 1, 1, b"")


def scene(verdicts: dict[int, str], *, owners: tuple[str, ...] = ("ann",), settled: bool = True) -> OccupancyMonitor:
    """Return frames at the given times: `alone`, `together` (kept, with somebody beside) or `lost` (withheld)."""
    alone = OccupancyMonitor()
    for sequence, (at_ms, verdict) in enumerate(verdicts.items()):
        alone.add_frame(sequence, at_ms)
        if not settled:
            continue
        alone.note(Decision(sequence, at_ms, owners, ""))
        for alias in owners:
            alone.note(
                WithheldFrame(sequence, at_ms, alias, WithholdReason.AMBIGUOUS)
                if verdict == "lost"
                else KeptFrame(sequence, at_ms, alias, CUT, verdict == "alone")
            )
    return alone


def every(step_ms: int, until_ms: int, verdict: str = "alone") -> dict[int, str]:
    return dict.fromkeys(range(0, until_ms + 1, step_ms), verdict)


def test_somebody_was_alone_only_once_the_frames_after_have_come_and_are_settled() -> None:
    judged = scene(every(100, 3_000)).find_occupancy(1_000, 1_200)
    assert judged is not None
    assert (judged.sole_owner, judged.owners) == ("ann", ("ann",))
    assert scene(every(100, 1_500)).find_occupancy(1_000, 1_000) is None
    assert scene(every(100, 3_000), settled=False).find_occupancy(1_000, 1_000) is None
    assert scene({}).find_occupancy(1_000, 1_000) is None
    judged = scene(every(100, 3_000), settled=False).find_occupancy(1_000, 1_000, final=True)
    assert judged is not None
    assert (judged.sole_owner, judged.owners) == ("", ())


def test_one_frame_with_somebody_beside_her_or_nobody_known_to_be_her_is_enough_to_withhold() -> None:
    judged = scene(every(100, 3_000) | {1_400: "together"}).find_occupancy(1_000, 1_000)
    assert judged is not None
    assert (judged.sole_owner, judged.reason) == ("", WithholdReason.NOT_ALONE)
    judged = scene(every(100, 3_000) | {600: "lost"}).find_occupancy(1_000, 1_000)
    assert judged is not None
    assert (judged.sole_owner, judged.reason) == ("", WithholdReason.NOT_MATCHED)


def test_every_tag_in_range_is_a_person_wherever_the_camera_looks() -> None:
    judged = scene(every(100, 3_000), owners=("ann", "ben")).find_occupancy(1_000, 1_000)
    assert judged is not None
    assert (judged.sole_owner, judged.owners) == ("", ("ann", "ben"))
    alone = scene(every(100, 9_000))
    alone.note_stranger(7_000, 7_000)
    early, late = alone.find_occupancy(1_500, 1_500), alone.find_occupancy(3_000, 3_000)
    assert early is not None
    assert late is not None
    assert (early.sole_owner, late.sole_owner) == ("ann", "")


def test_colour_is_cut_out_only_by_the_frame_of_the_same_moment() -> None:
    alone = scene(every(100, 3_000))
    assert [type(verdict) for verdict in alone.silhouettes(1_010) or ()] == [KeptFrame]
    assert alone.silhouettes(1_050) == []
    assert alone.silhouettes(2_990) is None


def test_a_storm_of_strangers_is_remembered_without_end_of_memory() -> None:
    alone = scene(every(100, 3_000))
    for number in range(5_000):
        alone.note_stranger(number * 20_000, number * 20_000)
    judged = alone.find_occupancy(1_000, 1_000)
    assert judged is not None
    assert judged.sole_owner == ""
    assert len(alone._strangers) <= 1_024


def test_a_gap_between_frames_vouches_for_nobody() -> None:
    for missing in (range(1_000, 1_600), range(400, 1_100), range(1_001)):
        verdicts = {at: verdict for at, verdict in every(100, 3_000).items() if at not in missing}
        judged = scene(verdicts).find_occupancy(1_000, 1_000)
        assert judged is not None
        assert judged.sole_owner == ""


def test_what_is_older_than_half_a_minute_is_forgotten() -> None:
    assert len(scene(every(100, 120_000))._frames) <= 302
