"""The summary of a run, as `robot run` and `robot replay` answer it with `--json`, and its parts."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.robot.consent.consent_view import ConsentCounts
from clients.robot.hiding.moving.driving_figures import DrivingFigures
from clients.robot.pairing.input_throttle import PipelineIntake
from clients.robot.recording.frame_answers import (
    AmbiguousTag,
    DistancesOff,
    FrameCounts,
    Latency,
    MergedTag,
    RunLatencies,
    SenseCounts,
)
from clients.robot.sensing.camera_intrinsics import CameraFigures
from clients.robot.sensing.input_checks import RunFault
from clients.sdk.terminal.json_answers import Answer, Count, Seconds, doc


class RunProgress(Answer, frozen=True, kw_only=True):
    """How far a run is; without figures if it was ended before there were any."""

    frames_read: Annotated[Count | UnsetType, doc("Frames that came; absent before the first figures")] = UNSET
    frames_recorded: Annotated[
        Count | UnsetType, doc("Frames that are final, counted for each owner; absent before the first figures")
    ] = UNSET
    records: Annotated[Count | UnsetType, doc("Records that are final; absent before the first figures")] = UNSET
    waiting: Annotated[Count | UnsetType, doc("Clips that wait in the spool; absent before the first figures")] = UNSET


class RunIntake(PipelineIntake, frozen=True, kw_only=True):
    """What was found of a run's source."""

    messages_refused: Annotated[dict[str, dict[str, Count]], doc("Unusable messages: by kind, how many by reason")]
    first_refused: Annotated[dict[str, str], doc("Why the first of these could not be used, by kind")]
    fault: Annotated[RunFault | None, doc("What ended the source; null if it ended properly")]
    antennas_unnamed: Annotated[
        dict[str, dict[str, Count]] | UnsetType,
        doc(
            "By topic: how often antennas were heard that the topics file names neither in `front` nor in `back`; absent "
            "for the synthetic corridor"
        ),
    ] = UNSET
    missed: Annotated[
        dict[str, Count] | UnsetType,
        doc("What was dropped for lack of room, by kind; absent unless the source is live"),
    ] = UNSET
    unread: Annotated[
        dict[str, Count] | UnsetType, doc("What still waited at the end, by kind; absent unless the source is live")
    ] = UNSET
    heard: Annotated[
        dict[str, Count] | UnsetType, doc("How many messages came, by topic; absent unless the source is live")
    ] = UNSET
    never_came: Annotated[
        dict[str, Count] | UnsetType, doc("What was sent and never came, by topic; absent unless the source is live")
    ] = UNSET
    gone: Annotated[
        dict[str, Count] | UnsetType, doc("How often a topic was gone; absent unless the source is live")
    ] = UNSET


class RunSummary(Answer, frozen=True, kw_only=True):
    """What became of all that a run saw."""

    roster_rows: Annotated[Count, doc("How many people of the roster the chain has confirmed")]
    consents: Annotated[ConsentCounts, doc("What was read of consents")]
    frames: Annotated[FrameCounts, doc("Depth frames")]
    ambiguous: Annotated[
        list[AmbiguousTag], doc("Tags with frames withheld as `ambiguous`, most frames first, 16 at most")
    ]
    merged: Annotated[list[MergedTag], doc("Tags with frames withheld as `merged`, most frames first, 16 at most")]
    distances_off: Annotated[
        list[DistancesOff],
        doc("Tags whose frames were kept though their distances disagree with the camera's, 16 at most"),
    ]
    senses: Annotated[dict[str, SenseCounts], doc("The same of each other sensor of which anything came")]
    latency_ms: Annotated[RunLatencies, doc("How long frames, or records, took until they were final")]
    hiding_ms: Annotated[Latency, doc("CPU time that finding, hiding and deciding took, of each frame")]
    intake: Annotated[RunIntake, doc("What was found of the source")]
    camera: Annotated[CameraFigures, doc("The lens")]
    driving: Annotated[
        DrivingFigures | None,
        doc("What was seen without the empty scene; null without `[odometry]` in the topics file"),
    ]
    records: Annotated[Count, doc("How many records are final")]
    stored_bytes: Annotated[Count, doc("How many bytes one custodian stores of them")]
    spool_peak_bytes: Annotated[Count, doc("The most that waited in the spool at once")]
    uploads_refused: Annotated[
        dict[str, Count], doc("How often a custodian took no upload, by the error's code; most are tried again")
    ]
    final_gap_max_s: Annotated[Seconds, doc("The longest time between two records that became final")]
