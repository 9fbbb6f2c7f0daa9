"""What a run says of the time when its camera did not see the empty scene."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, Count, doc

NO_FLOOR = "The empty scene shows no floor: without it nothing is kept, not even at stops. Record one that does."


class DrivingFigures(Answer, frozen=True, kw_only=True):
    """How people were hidden by a robot that says where it is."""

    keep: Annotated[bool, doc("Whether people are kept without the empty scene: `odometry.keep` in the topics file")]
    places: Annotated[Count, doc("Places of odometry that came")]
    doubts: Annotated[Count, doc("How often the camera saw that the odometry was wrong")]
    home_lost: Annotated[
        bool,
        doc(
            "Whether the empty scene no longer counted at the end: odometry or camera clock may have begun anew elsewhere"
        ),
    ]
    frames: Annotated[Count, doc("Frames in which people were looked for without the empty scene")]
    kept: Annotated[Count, doc("Pictures of these that show their owner, without the room")]
    unplaced_readings: Annotated[
        Count, doc("Readings that bound nobody: it was not known whether the robot stood then")
    ]
    camera_height_m: Annotated[
        float | None,
        doc(
            "Of the camera above the floor; null without `keep`, or if the empty scene shows no floor: then none is kept"
        ),
    ]
    camera_pitch_deg: Annotated[float | None, doc("How far the camera looks down, in degrees; null as above")]
