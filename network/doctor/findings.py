"""The fixed list of the doctor's findings.

A *problem* sets the doctor's exit code to 1; a *warning* does not yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["problem", "warning"]


@dataclass(frozen=True, slots=True)
class FindingKind:
    """One kind of finding: code, severity, next step."""

    code: str
    severity: Severity
    meaning: str
    next_step: str


def _table(*rows: FindingKind) -> dict[str, FindingKind]:
    return {row.code: row for row in rows}


KINDS: dict[str, FindingKind] = _table(
    FindingKind(
        "CONFIGURATION_WRONG",
        "problem",
        "The node's configuration, genesis file or data directory cannot be used.",
        "Mend node.toml or put the genesis file back; compare both with another node's.",
    ),
    FindingKind(
        "GENESIS_DIFFERS",
        "problem",
        "The node is of another network: its genesis file is not that of the others.",
        "Put the network's genesis file into the data directory, or move the node out of the network's folder.",
    ),
    FindingKind(
        "UPLOADS_PAUSED",
        "problem",
        "The custodian's disk is down to its reserve, so it takes no uploads.",
        "Give its disk more room, see who fills it with blockrobot custody status, or lower [custody] reserve_mib.",
    ),
    FindingKind(
        "UPLOADS_REFUSED",
        "warning",
        "A robot was refused uploads: a quota, the disk's reserve, or no open visit.",
        "See blockrobot custody status for the codes. UPLOAD_QUOTA_EXCEEDED: raise a quota that is too low with blockrobot "
        "settings propose. Others that go on: ask the robot's organisation, which may remove the robot.",
    ),
    FindingKind(
        "UPLOAD_QUOTA_NEAR",
        "warning",
        "A robot has used most of what it may upload.",
        "See blockrobot custody status; raise a quota that is too low with blockrobot settings propose.",
    ),
    FindingKind(
        "DISK_FILLS_UP",
        "warning",
        "At this rate the custodian's disk reaches its reserve within a week.",
        "Give its disk more room, or let organisations lower robot_day_max_mib with blockrobot settings propose.",
    ),
    FindingKind(
        "CUSTODY_FAILING",
        "problem",
        "The custodian cannot do part of its work: its store, its place of clips or its erase keys fail.",
        "Mend what was seen, or start that server: the custodian goes on by itself; see blockrobot custody status NODE.",
    ),
    FindingKind(
        "CUSTODY_SILENT",
        "warning",
        "The custodian does not say how it stands.",
        "See blockrobot custody status NODE, and blockrobot logs NODE for the first error.",
    ),
    FindingKind(
        "OLD_BLOCKS_HELD",
        "warning",
        "The node keeps older blocks than due: its custodian has not followed the chain that far.",
        "See blockrobot custody status NODE, and blockrobot logs NODE for what stops it; it drops them once it has.",
    ),
    FindingKind(
        "NODE_DOWN",
        "problem",
        "The node does not run.",
        "Start it: blockrobot node run NODE --detach; all of a network on this machine alone: blockrobot up.",
    ),
    FindingKind(
        "NODE_SILENT",
        "problem",
        "The node's process is there but does not answer.",
        "It may be starting, paused or stuck: see blockrobot logs NODE; kill and start it if it stays so.",
    ),
    FindingKind(
        "NODE_FAULT",
        "problem",
        "The node says that it cannot take part.",
        "See blockrobot logs NODE for the first error; mend what it names, then restart the node.",
    ),
    FindingKind(
        "NODE_NOT_ADDED",
        "warning",
        "The network does not know the node (yet), as far as the node's own chain says.",
        "Have it added: blockrobot org propose add-node --from node-entry.json; if it was, let it catch up.",
    ),
    FindingKind(
        "NODE_REMOVED",
        "warning",
        "The network removed the node.",
        "Stop it: blockrobot down NODE; keep or destroy its data directory.",
    ),
    FindingKind(
        "NODE_BEHIND",
        "warning",
        "The node's chain is far behind the others'.",
        "Wait while it catches up; if it does not, look at its links and its log.",
    ),
    FindingKind(
        "REMOTE_NODE_SILENT",
        "warning",
        "A node that is not in this folder does not answer here as that node.",
        "Ask its organisation whether it runs (if it is gone for good: blockrobot org propose remove-node NODE); if it is "
        "only reached in another way from here: blockrobot --node URL doctor.",
    ),
    FindingKind(
        "REMOTE_NODE_BEHIND",
        "warning",
        "A node that is not in this folder proves a chain far behind the others'.",
        "Ask its organisation; on its machine blockrobot doctor says more.",
    ),
    FindingKind(
        "PRODUCER_LOCKED_OUT",
        "warning",
        "The producer signs nothing for now: its data directory or journal came from a backup.",
        "Wait: it signs again when the chain has gone on without it long enough.",
    ),
    FindingKind(
        "LOCKED_OUT_FOR_GOOD",
        "problem",
        "More producers are locked out than the chain tolerates (of two or three: one): nothing becomes final any more.",
        "Waiting does not help. If the data directory of NODE's last run is left, with its journal, put that back and "
        "start it without --restored; else the organisations have to begin a new network: docs/how-to/restore-a-backup.md.",
    ),
    FindingKind(
        "PRODUCER_ASKS",
        "warning",
        "The producer signs nothing until enough others have said what they last heard of it, as at every start.",
        "If it stays so, start the other producers: with it, it takes 2 of 2, 3 of 3 or 4, 5 of 6.",
    ),
    FindingKind(
        "PRODUCER_SUSPENDED",
        "problem",
        "The producer signed twice in one round, as evidence on the chain proves: it is suspended.",
        "Find out why (a restored copy, one key on two machines), mend it, then a majority reinstates it: "
        "blockrobot producer approve NODE --as ORG (docs/how-to/govern-a-network.md).",
    ),
    FindingKind(
        "BLOCK_NOT_EXECUTED",
        "problem",
        "The node cannot execute a block that others could: it tries again and again, and serves an older state.",
        "Give it memory, raise memory_mib in [contracts] of node.toml, or put the newest program on it; start it again.",
    ),
    FindingKind(
        "CONTRACT_SANDBOX_INCOMPLETE",
        "warning",
        "The sandbox of the processes that run contracts lacks something, or is switched off.",
        "Give the node what is named (docs/explanation/sandbox.md), or set sandbox in [contracts] of node.toml.",
    ),
    FindingKind(
        "FAULT_ON_PURPOSE",
        "warning",
        "Somebody switched a fault on; what else is found may come from it.",
        "If the experiment is over: blockrobot fault heal.",
    ),
    FindingKind(
        "LINK_MISSING",
        "problem",
        "Two nodes that run are not linked.",
        "Look at what stands between them: network, firewall, faults that are on (blockrobot fault list).",
    ),
    FindingKind(
        "PEER_CUT_OFF",
        "problem",
        "A node hears no more of a peer for a while: it sent what no honest node sends.",
        "Look at that node's machine and program; if its key may be stolen: blockrobot certificate renew NODE --new-key.",
    ),
    FindingKind(
        "OVER_BUDGET",
        "warning",
        "Somebody asks a node for more work than they may cause; the others go on.",
        "Find out who that is (an address, a member's handle, a visit, a peer); suspend the member or block the address "
        "if need be.",
    ),
    FindingKind(
        "PEER_REFUSED",
        "problem",
        "A node refuses a peer.",
        "Do what is said with the refusal; more on its code is in docs/reference/errors.md.",
    ),
    FindingKind(
        "STATE_DIVERGED",
        "problem",
        "Nodes have different states at the same height.",
        "Stop trusting either; find the first difference: blockrobot node diff A B.",
    ),
    FindingKind(
        "FINALITY_STALE",
        "problem",
        "Nothing has become final for long.",
        "Bring back enough producers for a quorum (2 of 2, 3 of 3 or 4, 5 of 6); see the other findings.",
    ),
    FindingKind(
        "CLOCK_SKEW",
        "problem",
        "The clock of the node, or of this machine, is wrong by much of what the chain tolerates.",
        "Set the clock (NTP, chrony); a producer whose clock is wrong gets no votes.",
    ),
    FindingKind(
        "VERSION_DIFFERS",
        "warning",
        "Nodes run different versions of the program.",
        "Bring all nodes to the same version, one after another.",
    ),
    FindingKind(
        "CERTIFICATE_EXPIRED",
        "problem",
        "The node's certificate is over: no peer talks to it.",
        "Renew it: blockrobot certificate renew NODE; a running node takes it at once.",
    ),
    FindingKind(
        "CERTIFICATE_EXPIRES_SOON",
        "warning",
        "The node's certificate ends within thirty days.",
        "Renew it: blockrobot certificate renew NODE; a running node takes it at once.",
    ),
    FindingKind(
        "CERTIFICATE_REVOKED",
        "problem",
        "The node's certificate was revoked: no peer talks to it.",
        "Make a new one: blockrobot certificate renew NODE --new-key.",
    ),
    FindingKind(
        "CERTIFICATE_UNFIT",
        "problem",
        "The node's certificate does not name the address at which others reach it, or does not serve a node.",
        "Renew it with each of its addresses: blockrobot certificate renew NODE --host ADDRESS.",
    ),
    FindingKind(
        "CERTIFICATE_UNUSABLE",
        "problem",
        "The node's certificate or TLS key cannot be used.",
        "Make both anew: blockrobot certificate renew NODE --new-key.",
    ),
    FindingKind(
        "AUTHORITY_EXPIRES_SOON",
        "warning",
        "An organisation's certificate authority ends within a year.",
        "Make a new one and have it agreed: blockrobot org propose replace-ca; then renew the nodes' certificates.",
    ),
    FindingKind(
        "AUTHORITY_UNREADABLE",
        "problem",
        "An organisation's certificate authority, as agreed on the chain, cannot be read: its nodes are strangers.",
        "Have a sound one agreed on: blockrobot org propose replace-ca; the other organisations can do that.",
    ),
    FindingKind(
        "KEY_FILE_EXPOSED",
        "problem",
        "Others than the node's user can read a key.",
        "chmod 600 the file (700 the folder); if others may have read it, replace the key.",
    ),
    FindingKind("KEY_FILE_MISSING", "problem", "A key file that node.toml names is not there.", "Put it back."),
    FindingKind(
        "DISK_LOW",
        "problem",
        "The disk of the data directory is nearly full.",
        "Free space, or move the directory to a larger disk; a node that cannot write signs nothing.",
    ),
    FindingKind(
        "DIRECTORY_UNWRITABLE",
        "problem",
        "The data directory cannot be written to.",
        "Check its owner, its mode and whether the disk is mounted read-only.",
    ),
    FindingKind(
        "PORT_TAKEN",
        "problem",
        "Another program listens on a port of this node, which does not run.",
        "Stop that program, or change the port in node.toml (the peers' port: by governance).",
    ),
    FindingKind(
        "JOURNAL_MISSING",
        "problem",
        "The node's voting journal is not there.",
        "Put the newest journal back, or start once with: blockrobot node run NODE --restored (not one of two or three "
        "producers, which would stop for good: docs/how-to/restore-a-backup.md).",
    ),
    FindingKind(
        "JOURNAL_DAMAGED",
        "problem",
        "The node's voting journal is damaged in its middle.",
        "Keep the directory for inspection; restore a backup and start once with --restored (not one of two or three "
        "producers, which would stop for good: docs/how-to/restore-a-backup.md).",
    ),
    FindingKind(
        "LEDGER_DAMAGED",
        "problem",
        "The node's ledger is damaged.",
        "Stop the node, keep the folder for inspection, and bring it back from a snapshot: blockrobot node snapshot.",
    ),
    FindingKind(
        "LEDGER_FOREIGN",
        "problem",
        "The node's ledger is of another network than its genesis file, so it does not start.",
        "Put the genesis file back that it has begun by; if that one is wrong, do what GENESIS_IN_USE says "
        "(docs/reference/errors.md).",
    ),
)


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding: code, node ("" for the whole network) and what was seen."""

    code: str
    node: str
    detail: str

    @property
    def kind(self) -> FindingKind:
        return KINDS[self.code]

    @property
    def next_step(self) -> str:
        return self.kind.next_step.replace("NODE", self.node) if self.node else self.kind.next_step


def in_order(findings: list[Finding]) -> list[Finding]:
    return sorted(set(findings), key=lambda item: (item.kind.severity, item.node, item.code, item.detail))
