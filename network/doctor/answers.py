"""Checks that compare running nodes' answers, collected before."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consensus.chain.messages import ASKING
from contracts.worker.sandbox import REQUIRED_PARTS
from network.cluster_monitor import clock_words, refusals_of, removal_of
from network.doctor.findings import Finding
from network.remote_nodes import RemoteNode
from node.directory.node_directory import DirectoryContent

BEHIND_BLOCKS_COUNT = 32
SKEW_SHARE = 0.5
STALE_HEARTBEATS_COUNT = 3


@dataclass(frozen=True, slots=True)
class Answer:
    """One node's answer: process presence, status, clock offset to this machine."""

    name: str
    running: bool
    status: dict[str, Any] | None
    offset_ms: int = 0
    taken_ports: tuple[int, ...] = ()


def check_presence(answers: Sequence[Answer], removed: frozenset[str] = frozenset()) -> list[Finding]:
    """Down or silent, and their taken ports; skips `removed` ones."""
    found = []
    for answer in answers:
        if answer.status is not None or (answer.name in removed and not answer.running):
            continue
        if answer.running:
            detail = f"Its process is there, but its operator port is silent.{_need_of(answer.name, answers)}"
            found.append(Finding("NODE_SILENT", answer.name, detail))
            continue
        found.append(Finding("NODE_DOWN", answer.name, f"Its process is not there.{_need_of(answer.name, answers)}"))
        found += [
            Finding("PORT_TAKEN", answer.name, f"Another program listens on port {port}.")
            for port in answer.taken_ports
        ]
    return found


def _need_of(name: str, answers: Sequence[Answer]) -> str:
    """Said of a producer where none can be done without."""
    statuses = [answer.status for answer in answers if answer.status is not None and answer.status.get("quorum")]
    if not any(name in status["producers"] and status["quorum"] == len(status["producers"]) for status in statuses):
        return ""
    return " Nothing becomes final without it: of up to three producers all are needed."


def _check_lockout(name: str, lockout: dict[str, Any]) -> Finding:
    if lockout["reason"] == ASKING:
        return Finding("PRODUCER_ASKS", name, f"It signs nothing until {lockout['until']}.")
    code = "PRODUCER_LOCKED_OUT" if lockout["can_end"] else "LOCKED_OUT_FOR_GOOD"
    return Finding(code, name, f"It signs nothing ({lockout['reason']}) until {lockout['until']}.")


def check_words(answers: Sequence[Answer]) -> list[Finding]:
    found = []
    for answer in answers:
        status = answer.status or {}
        if status.get("fault"):
            found.append(Finding("NODE_FAULT", answer.name, str(status["fault"])))
        execution = status.get("execution") or {}
        if execution.get("stuck"):
            stuck = execution["stuck"]
            detail = f"It has tried block {stuck['height']} {stuck['attempts']} times: {execution['last_failure']}"
            found.append(Finding("BLOCK_NOT_EXECUTED", answer.name, detail))
        if status.get("lockout"):
            found.append(_check_lockout(answer.name, status["lockout"]))
        if status.get("suspended_height") is not None:
            detail = f"It has been suspended since height {status['suspended_height']}: blockrobot producer list"
            found.append(Finding("PRODUCER_SUSPENDED", answer.name, f"{detail} shows why."))
        lacks = _what_the_sandbox_lacks(status.get("contracts", {}))
        if lacks:
            found.append(Finding("CONTRACT_SANDBOX_INCOMPLETE", answer.name, lacks))
        if status.get("blocks_kept", {}).get("held_by") == "custodian":
            detail = f"It has blocks from {status['earliest_height']} on; custody is at {status['custody_checkpoint']}."
            found.append(Finding("OLD_BLOCKS_HELD", answer.name, detail))
        found += _check_floods(answer.name, status)
        found += [Finding("PEER_REFUSED", peer, detail) for peer, detail in refusals_of(answer.name, status)]
    return found


def _check_floods(name: str, status: dict[str, Any]) -> list[Finding]:
    found = []
    for row in status.get("cut_off_peers", []):
        detail = f"{name} cut {row['peer']} off {row['count']} times, the last time for {row['code']}: {row['detail']}"
        found.append(Finding("PEER_CUT_OFF", str(row["peer"]), detail))
    for row in status.get("over_budget", []):
        detail = f"At {name}, {row['peer']} is over its budget: it was refused or held up {row['count']} times."
        found.append(Finding("OVER_BUDGET", name, detail))
    return found


def _what_the_sandbox_lacks(contracts: dict[str, Any]) -> str:
    if contracts.get("sandbox") == "off":
        return "Contracts run inside the node: the sandbox is switched off."
    missing = contracts.get("blocks", {}).get("missing", {})
    named = [f"{name} ({why})" for name, why in sorted(missing.items()) if name in REQUIRED_PARTS]
    return f"The sandbox of contracts lacks {', '.join(named)}." if named else ""


def check_membership(answers: Sequence[Answer], directory: DirectoryContent) -> list[Finding]:
    found = []
    for answer in answers:
        name, node = answer.name, directory.nodes.get(answer.name)
        removal = removal_of(name, answer.status or {})
        if node is not None and not directory.is_active(node):
            found.append(Finding("NODE_REMOVED", name, f"It was removed at height {node.since_height}."))
        elif removal:
            found.append(Finding("NODE_REMOVED", name, removal))
        elif node is None:
            found.append(Finding("NODE_NOT_ADDED", name, f"The chain does not name it at height {directory.height}."))
    return found


def check_links(answers: Sequence[Answer], directory: DirectoryContent) -> list[Finding]:
    here = {
        answer.name: answer.status
        for answer in answers
        if answer.status is not None and answer.name in directory.active and not answer.status.get("problem")
    }
    found = []
    for name, status in sorted(here.items()):
        refused = _not_heard(status)
        for other, theirs in sorted(here.items()):
            refuses = _not_heard(theirs)
            linked = other in status.get("peers", []) and name in theirs.get("peers", [])
            if name < other and not linked and other not in refused and name not in refuses:
                found.append(Finding("LINK_MISSING", name, f"{name} and {other} both run, but are not linked."))
    return found


def _not_heard(status: dict[str, Any]) -> set[str]:
    return {row["peer"] for key in ("refused_peers", "cut_off_peers") for row in status.get(key, [])}


def check_clocks(answers: Sequence[Answer], max_drift_ms: int) -> list[Finding]:
    found = []
    for answer in answers:
        if answer.status is not None and abs(answer.offset_ms) > max_drift_ms * SKEW_SHARE:
            word = "ahead of" if answer.offset_ms > 0 else "behind"
            detail = (
                f"Its clock is {abs(answer.offset_ms) / 1000:.1f} s {word} this machine's; "
                f"the chain tolerates {max_drift_ms / 1000:.1f} s."
            )
            found.append(Finding("CLOCK_SKEW", answer.name, detail))
        elif error_s := ((answer.status or {}).get("finality") or {}).get("clock_error_s"):
            found.append(Finding("CLOCK_SKEW", answer.name, clock_words(error_s)))
    return found


def check_heights(answers: Sequence[Answer], elsewhere: Sequence[RemoteNode] = ()) -> list[Finding]:
    """Who is behind, here and elsewhere, and who elsewhere does not answer."""
    here = {answer.name: answer.status["finalized_height"] for answer in answers if answer.status is not None}
    there = {node.name: node.finalized_height for node in elsewhere if node.finalized_height is not None}
    highest = max([*here.values(), *there.values()], default=0)
    found = [
        Finding(code, name, f"It is at height {height}; another node is at {highest}.")
        for code, heights in (("NODE_BEHIND", here), ("REMOTE_NODE_BEHIND", there))
        for name, height in sorted(heights.items())
        if highest - height > BEHIND_BLOCKS_COUNT
    ]
    for node in elsewhere:
        if node.problem is not None:
            detail = f"Asked at {node.api_url} ({node.organisation}): {node.problem.detail} ({node.problem.code})"
            detail += _need_of(node.name, answers)
            found.append(Finding("REMOTE_NODE_SILENT", node.name, detail))
    return found


def check_versions(answers: Sequence[Answer], own_version: str) -> list[Finding]:
    versions = {answer.name: str(answer.status["version"]) for answer in answers if answer.status is not None}
    usual = Counter([*versions.values(), own_version]).most_common(1)[0][0]
    return [
        Finding("VERSION_DIFFERS", name, f"It runs {version}; most run {usual}.")
        for name, version in sorted(versions.items())
        if version != usual
    ]


def check_roots(roots: dict[str, dict[int, str]]) -> list[Finding]:
    """Deviating state roots (name -> height -> root): the minority, or all without majority."""
    found = []
    named: set[str] = set()
    for height in sorted({height for known in roots.values() for height in known}):
        here = {name: known[height] for name, known in roots.items() if height in known}
        counts = Counter(here.values()).most_common()
        if len(counts) < 2:
            continue
        usual = counts[0][0] if counts[0][1] > counts[1][1] else None
        for name, root in sorted(here.items()):
            if root != usual and name not in named:
                named.add(name)
                detail = f"At height {height} its state root is {root[:16]}...; others have another one."
                found.append(Finding("STATE_DIVERGED", name, detail))
    return found


def check_finality(newest_ms: int, now_ms: int, heartbeat_ms: int, production: str, up_s: float) -> list[Finding]:
    tolerated_ms = STALE_HEARTBEATS_COUNT * heartbeat_ms
    if production == "manual" or up_s * 1000 < tolerated_ms or now_ms - newest_ms <= tolerated_ms:
        return []
    detail = (
        f"The newest final block is {(now_ms - newest_ms) // 1000} s old; one is due every {heartbeat_ms // 1000} s."
    )
    return [Finding("FINALITY_STALE", "", detail)]


def check_late(answers: Sequence[Answer]) -> list[Finding]:
    finalities = {answer.name: (answer.status or {}).get("finality") or {} for answer in answers}
    late = {name: finality for name, finality in finalities.items() if finality.get("late")}
    if not late:
        return []
    age_s, waiting_s = (max(finality[key] for finality in late.values()) for key in ("age_s", "waiting_s"))
    work = f", and work has waited for {waiting_s:.0f} s" if waiting_s else ""
    told = next(((answer.status or {}) for answer in answers if answer.name in late), {})
    needed = f" Of {len(told['producers'])} producers {told['quorum']} are needed." if "quorum" in told else ""
    return [Finding("FINALITY_STALE", "", f"No new final block for {age_s:.0f} s at {', '.join(late)}{work}.{needed}")]
