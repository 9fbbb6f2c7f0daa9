"""Figures of the prototype's two published runs, for comparison.

Computed from the event logs published with the first BlockRobot prototype; run 1's are reproduced by `blockrobot
experiment compare LOG`. Names as in `figure_rows`.
"""

from __future__ import annotations

from dataclasses import dataclass

SOURCE = (
    "worked out from the event logs that the authors of the first BlockRobot prototype published with it, one for an "
    "experiment with one person and one for an experiment with two"
)


@dataclass(frozen=True, slots=True)
class PublishedRun:
    """One published run: display name, figures by name, and pairing facts."""

    name: str
    figures: dict[str, float]
    remark: str = ""


RUN_1 = PublishedRun(
    "published run 1 (one person)",
    {
        "length (s)": 49.9,
        "frames that the camera published": 1_497,
        "frames received": 1_124,
        "frames lost before they arrived (%)": 24.9,
        "tag readings": 4,
        "tags": 1,
        "frames received within 5 s of a reading, by arrival": 486,
        "frames paired": 79,
        "frames on the chain": 79,
        "frames on the chain of those received (%)": 7.0,
        "frames published while it paired": 325,
        "frames recorded a second, mean": 4.6,
        "frames recorded in the busiest second": 9,
        "received to paired, mean (ms)": 687,
        "paired to on the chain, mean (ms)": 1_996,
        "paired to on the chain, p95 (ms)": 2_745,
        "paired to on the chain, max (ms)": 2_908,
        "received to on the chain, mean (ms)": 2_683,
        "received to on the chain, p95 (ms)": 3_856,
        "received to on the chain, max (ms)": 4_089,
    },
    " None of these was received within five seconds of a reading: they came 22 to 37 s into the run, since frames had "
    "queued up and were paired by the clock of their turn.",
)
RUN_2 = PublishedRun(
    "published run 2 (two people)",
    {
        "length (s)": 60.8,
        "frames that the camera published": 1_616,
        "frames received": 1_069,
        "frames lost before they arrived (%)": 33.8,
        "tag readings": 17,
        "tags": 4,
        "frames received within 5 s of a reading, by arrival": 934,
        "frames paired": 142,
        "frames on the chain": 142,
        "frames on the chain of those received (%)": 13.3,
        "frames published while it paired": 706,
        "frames recorded a second, mean": 4.7,
        "frames recorded in the busiest second": 10,
        "received to paired, mean (ms)": 664,
        "paired to on the chain, mean (ms)": 2_002,
        "paired to on the chain, p95 (ms)": 2_658,
        "paired to on the chain, max (ms)": 3_373,
        "received to on the chain, mean (ms)": 2_667,
        "received to on the chain, p95 (ms)": 3_541,
        "received to on the chain, max (ms)": 3_966,
    },
)
