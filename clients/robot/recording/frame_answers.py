"""What a run counts of its frames, in the answers of `robot run` and `robot replay`."""

from __future__ import annotations

from typing import Annotated

from clients.robot.hiding.withhold_reason import MergedNumbers
from clients.robot.matching.match_evidence import MatchNumbers
from clients.sdk.terminal.json_answers import Answer, Count, MsFloat, doc


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


class AmbiguousTag(MatchNumbers, frozen=True, kw_only=True):
    """A tag with frames withheld as `ambiguous`: the matcher's numbers where it came nearest to a decision."""

    alias: Annotated[str, doc("The tag's alias in this run, as in the event log")]
    frames: Annotated[Count, doc("How many frames")]
    help: Annotated[str, doc("What helps")]


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
