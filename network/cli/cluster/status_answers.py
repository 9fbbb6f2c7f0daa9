"""What `blockrobot up` and `status` answer with `--json`."""

from __future__ import annotations

from typing import Annotated

from msgspec import UNSET, UnsetType

from clients.sdk.terminal.json_answers import (
    Answer,
    AnswerLine,
    AnswersByCommand,
    Count,
    Height,
    Hex,
    Seconds,
    TimeMs,
    doc,
)
from network.cli.cluster.cluster_answers import ConsoleAnswer
from network.remote_nodes import RemoteNode


class KeptBlocks(Answer, frozen=True, kw_only=True):
    """How far back a node keeps blocks."""

    archive: Annotated[bool, doc("Whether it keeps the bodies of all blocks")]
    earliest_ms: Annotated[TimeMs | None, doc("The time of the oldest block whose body it has; null if unreadable")]
    held_by: Annotated[
        str | None,
        doc(
            "Why older blocks than due are there: `keep_blocks`, `custodian` (has not followed them) or `record` (one "
            "under a claim); null if none are"
        ),
    ]


class StuckBlock(Answer, frozen=True, kw_only=True):
    """A block that others could execute and the node cannot."""

    height: Annotated[Height, doc("Its height")]
    attempts: Annotated[Count, doc("How often it was tried")]


class ExecutionState(Answer, frozen=True, kw_only=True):
    """What a node could not execute."""

    held: Annotated[Count, doc("Transactions that it proposes in no block now")]
    failures: Annotated[Count, doc("Executions that failed since its start")]
    last_failure: Annotated[str, doc("Why the last one failed; empty if none did")]
    stuck: Annotated[StuckBlock | None, doc("The block that only this node cannot execute; null if there is none")]


class ProducerLockout(Answer, frozen=True, kw_only=True):
    """Why a producer signs nothing."""

    reason: Annotated[str, doc("Why")]
    until: Annotated[str, doc("Until when")]
    can_end: Annotated[bool, doc("Whether that can come: not while more are locked out than the chain tolerates")]


class FinalityState(Answer, frozen=True, kw_only=True):
    """Whether blocks become final in time."""

    age_s: Annotated[Seconds, doc("Since a block became final")]
    waiting_s: Annotated[Seconds, doc("For how long work has waited")]
    late: Annotated[bool, doc("Whether that is too long")]
    clock_error_s: Annotated[
        float,
        doc("By how much the node's clock is ahead of new final blocks, or behind if negative; 0 if it fits them"),
    ]


class AccusedNode(Answer, frozen=True, kw_only=True):
    """A node that is proved to have equivocated."""

    name: Annotated[str, doc("The node")]
    state: Annotated[str, doc("`evidence` (held here, not on the chain yet) or `suspended`")]
    height: Annotated[Height | None, doc("Where it was suspended; null before that")]


class NodeCertificateState(Answer, frozen=True, kw_only=True):
    """The certificate that a node uses."""

    serial: Annotated[str, doc("Its serial number, hexadecimal digits")]
    state: Annotated[str, doc("`valid`, `expiring` (in its last 30 days) or `expired`")]
    not_before_ms: Annotated[TimeMs, doc("Since when it counts")]
    not_after_ms: Annotated[TimeMs, doc("Until when")]
    expires: Annotated[str, doc("The same, as `2028-11-21 12:45 UTC`")]


class NodeProblem(Answer, frozen=True, kw_only=True):
    """Why other nodes reject a node."""

    code: Annotated[str, doc("The error's code")]
    detail: Annotated[str, doc("What happened")]
    next_step: Annotated[str, doc("What to do")]


class PeerRefusal(NodeProblem, frozen=True, kw_only=True):
    """A peer, address or member that was refused in the last minute."""

    peer: Annotated[str, doc("The node; where a budget is exceeded also an address or a member's key")]
    since_ms: Annotated[TimeMs, doc("Since when, by the node's own clock")]
    count: Annotated[Count, doc("How often")]


class PeerPause(NodeProblem, frozen=True, kw_only=True):
    """A node that was cut off for sending what no honest one sends."""

    peer: Annotated[str, doc("The node")]
    count: Annotated[Count, doc("How often since the node's start")]
    until_ms: Annotated[TimeMs, doc("Until when, by the node's own clock")]


class ContractWorker(Answer, frozen=True, kw_only=True):
    """A process that runs contracts."""

    pid: Annotated[Count | None, doc("Its process; null if none was needed yet")]
    replaced: Annotated[Count, doc("How often it was replaced")]
    last_loss: Annotated[str, doc("Why it was replaced the last time; empty if it never was")]
    missing: Annotated[dict[str, str], doc("Parts of the sandbox that this system lacks, and why")]


class ContractSandbox(Answer, frozen=True, kw_only=True):
    """How a node runs contracts."""

    sandbox: Annotated[str, doc("How strict it is; `off`: contracts run in the node's own process")]
    blocks: Annotated[ContractWorker | UnsetType, doc("The worker for blocks; absent with `off`")] = UNSET
    views: Annotated[ContractWorker | UnsetType, doc("The worker for views; absent with `off`")] = UNSET


class ConsensusRound(Answer, frozen=True, kw_only=True):
    """What a node sent in a round of consensus."""

    epoch: Annotated[Count, doc("The epoch")]
    round: Annotated[Count, doc("The round")]
    leader: Annotated[str | None, doc("Who led it; null if its name is not known")]
    messages: Annotated[dict[str, TimeMs], doc("The kinds of message that it sent, and when, by its own clock")]


class NodeStatus(Answer, frozen=True, kw_only=True):
    """A node. All but `name` and `running` are absent if it is stopped or does not answer.

    One of another version may lack some of them.
    """

    name: Annotated[str, doc("The node")]
    running: Annotated[bool, doc("Whether its process runs")]
    organisation: Annotated[str | UnsetType | None, doc("Whose node it is; null if the chain does not know it")] = UNSET
    membership: Annotated[str | UnsetType, doc("`active`, `removed` or `unknown`, by its own chain")] = UNSET
    directory_height: Annotated[Height | UnsetType, doc("The block of its list of nodes")] = UNSET
    chain_id: Annotated[Hex | UnsetType, doc("The network")] = UNSET
    ready: Annotated[bool | UnsetType, doc("Whether it reaches a quorum, is not far behind, and can write")] = UNSET
    height: Annotated[Height | UnsetType, doc("Its newest certified block")] = UNSET
    finalized_height: Annotated[Height | UnsetType, doc("Its newest final block")] = UNSET
    earliest_height: Annotated[Height | UnsetType, doc("The oldest block whose body it has")] = UNSET
    blocks_kept: Annotated[KeptBlocks | UnsetType, doc("How far back it keeps blocks")] = UNSET
    state_root: Annotated[Hex | UnsetType | None, doc("The root of its state; null before its first block")] = UNSET
    state_height: Annotated[Height | UnsetType | None, doc("The block of it; null before its first block")] = UNSET
    round: Annotated[Count | UnsetType, doc("Its consensus round")] = UNSET
    epoch: Annotated[Count | UnsetType, doc("Its epoch")] = UNSET
    leader: Annotated[str | UnsetType | None, doc("The leader of the round; null if its name is not known")] = UNSET
    peers: Annotated[list[str] | UnsetType, doc("Names of the nodes that it is connected to")] = UNSET
    mempool: Annotated[Count | UnsetType, doc("Transactions in its mempool")] = UNSET
    custody_checkpoint: Annotated[
        Height | UnsetType | None, doc("The block that its custodian has followed to; null if it is no custodian")
    ] = UNSET
    custody_failing: Annotated[str | UnsetType | None, doc("Why its custodian cannot work; null if it can")] = UNSET
    fault: Annotated[str | UnsetType, doc("Why it has stopped taking part; empty if it has not")] = UNSET
    execution: Annotated[ExecutionState | UnsetType, doc("What it could not execute")] = UNSET
    lockout: Annotated[ProducerLockout | UnsetType | None, doc("Why it signs nothing; null if it may sign")] = UNSET
    finality: Annotated[FinalityState | UnsetType, doc("Whether blocks become final in time")] = UNSET
    suspended_height: Annotated[
        Height | UnsetType | None, doc("Where its producer was suspended; null if it is not")
    ] = UNSET
    accused: Annotated[list[AccusedNode] | UnsetType, doc("Nodes that equivocated, as this node says")] = UNSET
    certificate: Annotated[NodeCertificateState | UnsetType, doc("Its certificate")] = UNSET
    refused_peers: Annotated[list[PeerRefusal] | UnsetType, doc("Nodes that it refused in the last minute")] = UNSET
    cut_off_peers: Annotated[list[PeerPause] | UnsetType, doc("Nodes that sent what no honest one sends")] = UNSET
    over_budget: Annotated[
        list[PeerRefusal] | UnsetType,
        doc("Who asked for too much work, sent faster than the node reads, or opened too many connections"),
    ] = UNSET
    refused_by: Annotated[list[PeerRefusal] | UnsetType, doc("Nodes that refused it in the last minute")] = UNSET
    problem: Annotated[NodeProblem | UnsetType | None, doc("Why all nodes reject it; null if they do not")] = UNSET
    now_ms: Annotated[TimeMs | UnsetType, doc("Its own clock")] = UNSET
    contracts: Annotated[ContractSandbox | UnsetType, doc("How it runs contracts")] = UNSET
    quorum: Annotated[Count | UnsetType, doc("How many producers make a quorum in its epoch")] = UNSET
    producers: Annotated[list[str] | UnsetType, doc("Nodes with a seat in that epoch, in turn")] = UNSET
    rounds: Annotated[list[ConsensusRound] | UnsetType, doc("Its last rounds")] = UNSET
    version: Annotated[str | UnsetType, doc("Its version of BlockRobot")] = UNSET
    uptime_s: Annotated[Seconds | UnsetType, doc("Since it was started")] = UNSET
    unread: Annotated[
        list[str] | UnsetType, doc("Fields that it says in another form, or with more in them; absent if there is none")
    ] = UNSET


class StatusAnswer(Answer, frozen=True, kw_only=True):
    """The nodes of a network. `ok` is false if one here is stopped or silent, or, with none here, if nobody answers."""

    directory: Annotated[str, doc("The network's folder")]
    nodes: Annotated[list[NodeStatus], doc("Each node of this folder")]
    elsewhere: Annotated[
        list[RemoteNode],
        doc("Of `status`: the network's other active nodes, as they answer everybody; empty if all are here"),
    ]


class WatchedNode(Answer, frozen=True, kw_only=True):
    """A node in a moment. Its figures are null if it does not answer."""

    name: Annotated[str, doc("The node")]
    state: Annotated[
        str,
        doc(
            "`stopped`, `paused`, `no answer`, `locked out: ...`, `removed`, `waiting`, `suspended`, `signing` or a fault"
        ),
    ]
    height: Annotated[Height | None, doc("Its newest certified block; null without an answer")]
    finalized_height: Annotated[Height | None, doc("Its newest final block; null without an answer")]
    round: Annotated[Count | None, doc("Its round; null without an answer")]
    epoch: Annotated[Count | None, doc("Its epoch; null without an answer")]
    leader: Annotated[str | None, doc("The leader of the round; null without an answer, or if its name is not known")]
    peers: Annotated[Count | None, doc("How many nodes it is connected to; null without an answer")]
    waiting: Annotated[Count | None, doc("Transactions in its mempool; null without an answer")]
    faults: Annotated[list[str], doc("Faults that are on")]
    accused_by: Annotated[list[str], doc("Other nodes that say that it equivocated, or is suspended")]


class WatchedAnswer(AnswerLine, frozen=True, kw_only=True):
    """The network in a moment: printed one a line, for each change, without `ok`."""

    at_s: Annotated[Seconds, doc("Since the watching began")]
    finalized_height: Annotated[int, doc("The highest final block that any node says; -1 before any did")]
    finality_age_s: Annotated[Seconds, doc("Since a height was last seen to become final")]
    stuck_s: Annotated[Seconds, doc("For how long work has waited without anything becoming final")]
    longest_stuck_s: Annotated[Seconds, doc("The longest such time")]
    nodes: Annotated[list[WatchedNode], doc("Each node")]
    changes: Annotated[list[str], doc("What changed since the line before, a sentence each")]


ANSWERS: AnswersByCommand = {
    "up": (StatusAnswer, ConsoleAnswer),
    "status": StatusAnswer,
    "status --watch": WatchedAnswer,
}
