"""The summary of a run, as `robot run` and `robot replay` answer it with `--json`, and its parts."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, Meta, UnsetType

from clients.sdk.terminal.json_answers import Answer, Count, Ms, Seconds, doc

MsFloat = Annotated[float, Meta(extra_json_schema={"unit": "ms"})]


class RunProgress(Answer, frozen=True, kw_only=True):
    """How far a run is; without figures if it was ended before there were any."""

    frames_read: Annotated[Count | UnsetType, doc("Frames that came; absent before the first figures")] = UNSET
    frames_recorded: Annotated[
        Count | UnsetType, doc("Frames that are final, counted for each owner; absent before the first figures")
    ] = UNSET
    records: Annotated[Count | UnsetType, doc("Records that are final; absent before the first figures")] = UNSET
    waiting: Annotated[Count | UnsetType, doc("Clips that wait in the spool; absent before the first figures")] = UNSET


class ConsentCounts(Answer, frozen=True, kw_only=True):
    """What was read of consents."""

    readings: Annotated[Count, doc("How often the registry was proved")]
    failed_readings: Annotated[Count, doc("How often it could not be")]
    stale_times: Annotated[Count, doc("How often what was proved was too old to record by")]
    stale_ms: Annotated[Ms, doc("For how long, together")]
    sightings_refused: Annotated[
        dict[str, Count],
        doc("Tag readings that counted for nothing, by reason: `no-consent`, `consent-coming`, `registry-stale`"),
    ]
    clips_dropped: Annotated[Count, doc("Clips dropped from the spool: consent had ended, or they were too old")]


class FrameCounts(Answer, frozen=True, kw_only=True):
    """What became of the frames, or messages, of one sensor."""

    published: Annotated[Count, doc("How many came")]
    covered: Annotated[Count, doc("How many of them are about an owner, counted for each owner")]
    kept: Annotated[Count, doc("How many of these are recorded, and final")]
    withheld: Annotated[Count, doc("How many of these are withheld")]
    withheld_reasons: Annotated[dict[str, Count], doc("The same by reason")]
    lost: Annotated[Count, doc("How many of these are neither")]


class SenseCounts(FrameCounts, frozen=True, kw_only=True):
    """What became of the messages of a sensor other than the depth camera."""

    dropped: Annotated[Count, doc("How many were dropped before a verdict, for lack of memory")]


class MatchNumbers(Answer, frozen=True, kw_only=True):
    """The matcher's numbers for a tag."""

    obstacle: Annotated[
        str,
        doc(
            "What stood in the way: `few-distances`, `behind`, `unit`, `delayed`, `off`, `vague`, `rival`, `no-facing` or "
            "`undecided`"
        ),
    ]
    log_odds: Annotated[float, doc("For the person in view who fits best")]
    needed: Annotated[float, doc("The log-odds at which a tag is bound")]
    distance_log_odds: Annotated[float, doc("What distances alone say for that person; 1.1 of it is needed")]
    rival_log_odds: Annotated[float | UnsetType, doc("For who fits next best; absent if one person was in view")] = (
        UNSET
    )
    distances: Annotated[Count, doc("How many distances were compared with the camera's")]
    gap_m: Annotated[float, doc("Mean of distance minus camera range, in metres")]
    spread_m: Annotated[float, doc("Standard deviation of distance minus camera range, in metres")]
    sigma_m: Annotated[float, doc("Mean stated standard deviation, in metres")]
    front: Annotated[Count, doc("Readings by antennas that look as the camera looks")]
    back: Annotated[Count, doc("Readings by antennas that look away from it")]
    people: Annotated[Count, doc("How many people were in view")]
    delay_ms: Annotated[
        Ms | UnsetType, doc("How much later than the person the distances are; absent if no shift makes them fit")
    ] = UNSET


class AmbiguousTag(MatchNumbers, frozen=True, kw_only=True):
    """A tag with frames withheld as `ambiguous`: the matcher's numbers where it came nearest to a decision."""

    alias: Annotated[str, doc("The tag's alias in this run, as in the event log")]
    frames: Annotated[Count, doc("How many frames")]
    help: Annotated[str, doc("What helps")]


class MergedNumbers(Answer, frozen=True, kw_only=True):
    """Why a silhouette was taken for two people, in numbers."""

    by: Annotated[str, doc("Which rule took it for two people: `area`, `breadth`, `shape` or `before`")]
    limit: Annotated[float, doc("Above what: square metres, metres, or log-odds (`shape` and `before`)")]
    log_odds: Annotated[float, doc("Of two people")]
    area_m2: Annotated[float, doc("The silhouette's area in square metres")]
    breadth_m: Annotated[float, doc("Its breadth about half a metre below the top of the head, in metres")]
    range_m: Annotated[float, doc("How far away it was, in metres")]


class MergedTag(MergedNumbers, frozen=True, kw_only=True):
    """A tag with frames withheld as `merged`: the silhouette that came nearest to being taken for one person."""

    alias: Annotated[str, doc("The tag's alias in this run, as in the event log")]
    frames: Annotated[Count, doc("How many frames")]
    help: Annotated[str, doc("What that means")]


class DistancesOff(Answer, frozen=True, kw_only=True):
    """A tag whose frames were kept though its distances disagree with the camera's."""

    alias: Annotated[str, doc("The tag's alias in this run")]
    frames: Annotated[Count, doc("How many frames")]
    gap_m: Annotated[float, doc("Mean of distance minus camera range, in metres")]
    spread_m: Annotated[float, doc("Standard deviation of the same, in metres")]
    sigma_m: Annotated[float, doc("Mean stated standard deviation, in metres")]


class Latency(Answer, frozen=True, kw_only=True):
    """A distribution of durations; zeros if there were none."""

    p50: Annotated[MsFloat, doc("The median")]
    p95: Annotated[MsFloat, doc("The 95th percentile")]
    max: Annotated[MsFloat, doc("The longest")]


class RunLatencies(Answer, frozen=True, kw_only=True):
    """How long frames, or records, took until they were final."""

    frame_to_final: Annotated[Latency, doc("From the end of the pairing window")]
    decided_to_final: Annotated[Latency, doc("From when hiding had settled it too")]
    arrival_to_final: Annotated[Latency, doc("From when it came")]
    submit_to_final: Annotated[Latency, doc("From when it was sent to the network")]


class DeviceClock(Answer, frozen=True, kw_only=True):
    """What was found of a device's clock."""

    offset_ms: Annotated[MsFloat, doc("Host time minus device time")]
    drift_ppm: Annotated[float, doc("How fast that grows, in millionths")]
    uncertainty_ms: Annotated[MsFloat, doc("How far it may be off")]
    sample_count: Annotated[Count, doc("From how many timestamps")]
    started_anew_count: Annotated[Count, doc("How often the clock was found to be set")]


class UnknownTagCounts(Answer, frozen=True, kw_only=True):
    """Tags that are not on the roster."""

    readings: Annotated[Count, doc("How many readings")]
    tags: Annotated[Count, doc("Of how many tags")]
    more_tags: Annotated[bool, doc("Whether there were more than could be told apart")]


class RunFault(Answer, frozen=True, kw_only=True):
    """What ended a source, or a run."""

    code: Annotated[str, doc("The error's code")]
    detail: Annotated[str, doc("What happened")]


class PipelineIntake(Answer, frozen=True, kw_only=True):
    """What the pipeline found of its input."""

    clocks: Annotated[dict[str, DeviceClock], doc("What was found of each device's clock")]
    turned_away: Annotated[dict[str, Count], doc("How much was rejected for its time, by reason")]
    sightings_late: Annotated[Count, doc("Tag readings that came too late")]
    sightings_shortened: Annotated[Count, doc("Tag readings whose uncertain end was cut")]
    sightings_only_paired: Annotated[Count, doc("Tag readings that were thinned out")]
    timelines: Annotated[Count, doc("How many timelines the timestamps made")]
    unknown_tags: Annotated[UnknownTagCounts, doc("Tags that are not on the roster")]


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


class CameraFigures(Answer, frozen=True, kw_only=True):
    """The camera's lens."""

    focal_px: Annotated[float, doc("Focal length in pixels")]
    focal_from: Annotated[str, doc("Where that is from")]
    frames_before: Annotated[Count, doc("How many frames came before it was known")]


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
    intake: Annotated[RunIntake, doc("What was found of the source")]
    camera: Annotated[CameraFigures, doc("The lens")]
    records: Annotated[Count, doc("How many records are final")]
    stored_bytes: Annotated[Count, doc("How many bytes one custodian stores of them")]
    spool_peak_bytes: Annotated[Count, doc("The most that waited in the spool at once")]
    uploads_refused: Annotated[
        dict[str, Count], doc("How often a custodian took no upload, by the error's code; most are tried again")
    ]
    final_gap_max_s: Annotated[Seconds, doc("The longest time between two records that became final")]
