"""What `blockrobot robot` answers with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.robot.run.run_summary import RunProgress, RunSummary
from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Hex, Problem, TimeMs, doc


class RobotPassphraseAnswer(Answer, frozen=True, kw_only=True):
    """How the robot's key file is kept."""

    sealed: Annotated[bool, doc("Whether a passphrase opens the key file")]


class RobotNewAnswer(RobotPassphraseAnswer, frozen=True, kw_only=True):
    """A robot whose keys were drawn."""

    folder: Annotated[str, doc("The robot's folder")]
    member: Annotated[Hex, doc("The robot's member key")]


class RobotRegisterAnswer(Answer, frozen=True, kw_only=True):
    """A robot that is registered."""

    txid: Annotated[Hex | None, doc("The registration; null if it had registered with this card before")]
    member: Annotated[Hex, doc("The robot's member key")]


class RobotTopic(Answer, frozen=True, kw_only=True):
    """A topic of a recording, or of a running robot."""

    topic: Annotated[str, doc("The topic's name")]
    type: Annotated[str, doc("Its message type")]
    count: Annotated[Count, doc("How many messages")]
    rate_hz: Annotated[float, doc("Messages a second")]
    encoding: Annotated[str | None, doc("How pictures in it are encoded; null if it has none, or none was seen")]
    could_be: Annotated[list[str], doc("What it could be")]


class RobotTopicsAnswer(Answer, frozen=True, kw_only=True):
    """The topics of a recording, or of a running robot."""

    topics: Annotated[list[RobotTopic], doc("Each topic")]
    broken: Annotated[str | None, doc("Where and how the recording breaks off; null if it does not")]
    draft: Annotated[str | None, doc("The topics file that was written; null without `--draft`")]
    next_steps: Annotated[list[str], doc("What to do next, a sentence each")]


class RobotAntennaPair(Answer, frozen=True, kw_only=True):
    """Two antennas: RSSI of `right` minus `left` is `offset_db` plus `slope_db_per_deg` for each degree to the right."""

    reader: Annotated[str | None, doc("The topic or address of their reader; null if it names none")]
    left: Annotated[int, doc("Number of the antenna that looks more to the left")]
    right: Annotated[int, doc("Number of the antenna that looks more to the right")]
    offset_db: Annotated[float, doc("Difference straight ahead, in dB")]
    slope_db_per_deg: Annotated[float, doc("How much it grows with each degree to the right")]
    sigma_db: Annotated[float, doc("Standard deviation of one difference")]
    sigma_deg: Annotated[float, doc("Standard deviation of one bearing, in degrees")]
    readings: Annotated[Count, doc("By how many pairs of readings")]


class RobotAntennasAnswer(Answer, frozen=True, kw_only=True):
    """Antennas that tell on which side a tag is, as one walk before the camera measured them."""

    pairs: Annotated[list[RobotAntennaPair], doc("The most exact first")]
    turn_deg: Annotated[float, doc("Over how many degrees four fifths of the walk went")]
    file: Annotated[str | None, doc("The file that was written; null without `--out`")]


class RobotViewpointAnswer(Answer, frozen=True, kw_only=True):
    """A viewpoint and its empty frames."""

    viewpoint: Annotated[str, doc("The viewpoint's name")]
    state: Annotated[str, doc("`recorded`, `approved`, `expired`, or `changed` since it was approved")]
    frames: Annotated[Count, doc("How many empty frames it has")]
    approved_by: Annotated[str, doc("Who approved them; empty until somebody did")]
    expires_at_ms: Annotated[TimeMs, doc("Until when that holds; 0 until approved")]
    preview: Annotated[str, doc("The picture to look at before approving")]
    digest: Annotated[Hex, doc("Hash of the frames, to which an approval is bound")]


class RobotViewpointsAnswer(Answer, frozen=True, kw_only=True):
    """The viewpoints of a robot."""

    viewpoints: Annotated[list[RobotViewpointAnswer], doc("Each viewpoint")]


class RobotRunAnswer(RunSummary, frozen=True, kw_only=True):
    """The summary of a run. `ok` is false if anything was lost, never came or was not read, or if the source broke off.

    While it runs, each line on standard error is `{"progress": {...}}` with the fields of `RunProgress`, or
    `{"notice": "..."}`.
    """

    error: Annotated[
        Problem | UnsetType, doc("`intake.fault` as in a refusal; absent if the source ended properly")
    ] = UNSET


class RobotRunEndedAnswer(Answer, frozen=True, kw_only=True):
    """A run that a second Ctrl-C ended at once; `ok` is false."""

    ended: Annotated[str, doc("`at-once`")]
    progress: Annotated[RunProgress, doc("How far it was")]
    spooled_clips: Annotated[Count, doc("Clips that the next run sends")]


ANSWERS: AnswersByCommand = {
    "robot new": RobotNewAnswer,
    "robot passphrase": RobotPassphraseAnswer,
    "robot register": RobotRegisterAnswer,
    "robot topics": RobotTopicsAnswer,
    "robot antennas": RobotAntennasAnswer,
    "robot background record": RobotViewpointAnswer,
    "robot background approve": RobotViewpointAnswer,
    "robot background list": RobotViewpointsAnswer,
    "robot replay": (RobotRunAnswer, RobotRunEndedAnswer),
    "robot run": (RobotRunAnswer, RobotRunEndedAnswer),
}
