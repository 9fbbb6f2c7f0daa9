"""What the commands about a network on this machine answer with `--json`."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, UnsetType, field

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Ms, Seconds, doc
from network.remote_nodes import RemoteNode


class DoctorFinding(Answer, frozen=True, kw_only=True):
    """A finding of the doctor."""

    code: Annotated[str, doc("The finding's code: docs/how-to/when-something-is-wrong.md")]
    severity: Annotated[Literal["problem", "warning"], doc("`problem` or `warning`")]
    node: Annotated[str, doc("At which node; empty for the whole network")]
    detail: Annotated[str, doc("What was seen")]
    next_step: Annotated[str, doc("What to do")]


class DoctorAnswer(Answer, frozen=True, kw_only=True):
    """What is wrong with a network or a node. `ok` is false if there is a problem."""

    nodes: Annotated[list[str], doc("The nodes of this folder that were examined")]
    elsewhere: Annotated[list[RemoteNode], doc("The network's other active nodes, as they answer everybody")]
    findings: Annotated[list[DoctorFinding], doc("What was found")]
    blocks_kept: Annotated[list[str], doc("How far back nodes keep blocks, a sentence for those that keep the same")]


class DownAnswer(Answer, frozen=True, kw_only=True):
    """A network, or nodes of it, that were stopped."""

    stopped: Annotated[list[str], doc("Names of the nodes that ran")]


class LogLine(Answer, frozen=True, kw_only=True):
    """A line of a node's log."""

    node: Annotated[str, doc("The node")]
    line: Annotated[str, doc("The line, itself JSON")]


class LogsAnswer(Answer, frozen=True, kw_only=True):
    """The last lines of logs."""

    lines: Annotated[list[LogLine], doc("Each line")]


class ConsoleAnswer(Answer, frozen=True, kw_only=True):
    """The console's page: printed once it is there; the command then runs until it is stopped."""

    url: Annotated[str, doc("The page's address; alone it opens nothing")]
    open: Annotated[str, doc("The file that opens the page, once")]


class ExploreAnswer(Answer, frozen=True, kw_only=True):
    """The page of a node's explorer: printed once it is there; the command then runs until it is stopped."""

    node: Annotated[str, doc("Whose explorer it is")]
    as_: Annotated[str, doc("The name of the session's owner")] = field(name="as")
    redirect_file: Annotated[str, doc("The file that opens the page, once")]
    valid_s: Annotated[Seconds, doc("For how long it does")]


class FaultAnswer(Answer, frozen=True, kw_only=True):
    """A fault that was injected or ended."""

    done: Annotated[str, doc("What was done")]


class FaultyLink(Answer, frozen=True, kw_only=True):
    """The fault of a link, in one direction."""

    delay_ms: Annotated[float, doc("How long every frame waits, in ms")]
    jitter_ms: Annotated[float, doc("The random delay on top of it, at most, in ms")]
    loss: Annotated[float, doc("The share of frames that are lost")]
    bandwidth_bytes_per_s: Annotated[Count, doc("Bytes a second; 0: no limit")]
    cut: Annotated[bool, doc("Whether nothing gets through")]


class SwitchedFaults(Answer, frozen=True, kw_only=True):
    """The faults that a node has switched on in itself."""

    links: Annotated[dict[str, FaultyLink], doc("The fault of the link to each node")]
    clock_offset_ms: Annotated[Ms, doc("By how much its clock is wrong")]
    disk: Annotated[list[str], doc("Which of its disks are full")]
    seed: Annotated[Count, doc("The seed of its links' random faults")]
    frames_lost: Annotated[Count, doc("How many frames were lost by them")]


class FaultyNode(Answer, frozen=True, kw_only=True):
    """The faults of a node."""

    name: Annotated[str, doc("The node")]
    running: Annotated[bool, doc("Whether its process runs")]
    paused: Annotated[bool, doc("Whether it is paused")]
    behaviour: Annotated[str, doc("How it is Byzantine; empty if it is honest")]
    switched: Annotated[SwitchedFaults | None, doc("The faults that it reports itself; null if it does not answer")]
    faults: Annotated[list[str], doc("All of that, a few words each")]


class FaultListAnswer(Answer, frozen=True, kw_only=True):
    """The faults of all nodes."""

    nodes: Annotated[list[FaultyNode], doc("Each node")]


class FaultError(Answer, frozen=True, kw_only=True):
    """Why a step was not done."""

    code: Annotated[str, doc("The error's code")]
    detail: Annotated[str, doc("What happened")]


class FaultStep(Answer, frozen=True, kw_only=True):
    """A step of a fault plan."""

    at_ms: Annotated[Ms, doc("When, from the plan's beginning")]
    line: Annotated[Count, doc("The plan's line")]
    do: Annotated[str, doc("What")]
    error: Annotated[
        FaultError | UnsetType | None, doc("Why it was not done; null if it was; absent with `--dry-run`")
    ] = UNSET


class FaultRunAnswer(Answer, frozen=True, kw_only=True):
    """A fault plan. `ok` is false if a step could not be done, or no node runs any more."""

    seed: Annotated[Count, doc("The seed of its random steps")]
    steps: Annotated[list[FaultStep], doc("Each step")]


ANSWERS: AnswersByCommand = {
    "down": DownAnswer,
    "logs": LogsAnswer,
    "console": ConsoleAnswer,
    "explore": ExploreAnswer,
    "fault kill": FaultAnswer,
    "fault restart": FaultAnswer,
    "fault pause": FaultAnswer,
    "fault resume": FaultAnswer,
    "fault partition": FaultAnswer,
    "fault heal": FaultAnswer,
    "fault link": FaultAnswer,
    "fault skew": FaultAnswer,
    "fault disk": FaultAnswer,
    "fault byzantine": FaultAnswer,
    "fault list": FaultListAnswer,
    "fault run": FaultRunAnswer,
    "doctor": DoctorAnswer,
}
