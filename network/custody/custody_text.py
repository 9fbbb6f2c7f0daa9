"""Custodians' answers as plain sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from consensus.errors import BlockRobotError
from node.custody.coordination.custody_answers import (
    CustodyStatus,
    FrameName,
    MissingReceipts,
    PartName,
    RebuildAnswer,
    RobotUploads,
    ScrubAnswer,
    UploadReport,
)

BEHIND_TOLERATED_BLOCKS = 8
_SHOWN_COUNT = 3

_REBUILD = "Next step: blockrobot custody rebuild {node}"
_SCRUB_FINDINGS = {
    "held_though_erased": ("{count} records are held though the chain has erased them: {ids}.", _REBUILD),
    "frames_held_though_erased": ("{count} frames are held though they were erased: {ids}.", _REBUILD),
    "unclaimed_frames": ("{count} records have frames that no clip claims: {ids}.", _REBUILD),
    "parts_held_though_ended": ("{count} parts of keys are held of shares that have ended: {ids}.", _REBUILD),
    "empty_frames_held_though_withdrawn": ("{count} empty frames are held that are approved no more: {ids}.", _REBUILD),
    "unclaimed_keys": ("{count} erase keys belong to no frame.", _REBUILD),
    "corrupted": ("{count} frames are damaged or gone: {ids}.", _REBUILD + ", which takes another custodian's copy"),
    "other_facts": ("{count} records are kept with another owner, time or root than the chain's: {ids}.", _REBUILD),
    "missing": ("{count} records are missing and are being fetched: {ids}.", "See blockrobot custody status {node}"),
    "unknown_to_chain": ("{count} records are held that the chain does not know: {ids}.", "Whose store is this?"),
}
_FAILING = {
    "following": "It has not been able to follow the chain",
    "uploads": "It has not been able to take uploads",
    "fetching": "It has not been able to fetch clips from others",
}
NEAR_SHARE = 0.8
RESERVE_LEFT_MIN_DAYS = 7
_MIB = 1024 * 1024

UploadProblem = tuple[Literal["UPLOADS_PAUSED", "DISK_FILLS_UP", "UPLOADS_REFUSED", "UPLOAD_QUOTA_NEAR"], str]


def describe_position(answer: CustodyStatus) -> str:
    behind = answer.behind_blocks
    if answer.failing:
        return "failing"
    if behind > BEHIND_TOLERATED_BLOCKS:
        return f"{behind} blocks behind"
    if not answer.custodian:
        return "no custodian"
    return "up to date" if answer.serving else "starting"


def failing_sentences(answer: CustodyStatus) -> list[str]:
    return [
        f"{_FAILING[failing.work]} for {failing.failing_s} s: {failing.detail.rstrip('.')} ({failing.code}). "
        f"Next step: {BlockRobotError(failing.code).next_step}"
        for failing in answer.failing
    ]


def status_sentences(
    names: Sequence[str], answers: Sequence[CustodyStatus | BlockRobotError], members: Mapping[str, str] | None = None
) -> list[str]:
    """One per problem. `members`: key (hex) to name, also of silent custodians."""
    sentences: list[str] = []
    names_of, waiting = dict(members or {}), dict[str, MissingReceipts]()
    for name, answer in zip(names, answers, strict=True):
        if isinstance(answer, BlockRobotError):
            sentences.append(f"{name}: {answer.detail} ({answer.code}). Next step: {answer.next_step}")
            continue
        names_of[answer.member] = name
        waiting.update(answer.waiting_for)
        if answer.failing:
            sentences += [f"{name}: {sentence}" for sentence in failing_sentences(answer)]
        elif answer.behind_blocks > BEHIND_TOLERATED_BLOCKS:
            sentences.append(f"{name} is {answer.behind_blocks} blocks behind the chain and follows; look again soon.")
        elif not answer.serving:
            sentences.append(f"{name} hands out no clip before it has followed the network; look again soon.")
        elif not answer.custodian:
            sentences.append(
                f"{name} is no custodian of the chain and takes no uploads. Next step: have it added; if it was removed, "
                f"stop it (blockrobot down {name}) once the others lack nothing."
            )
        sentences += [f"{name}: {sentence}" for _, sentence in find_upload_problems(answer)]
        if answer.clips_missing:
            sentences.append(f"{name} lacks {answer.clips_missing} clips and fetches them from other custodians.")
    for member, entry in waiting.items():
        for erasure in entry.overdue[:_SHOWN_COUNT]:
            who = names_of.get(member, f"the custodian with key {member[:16]}...")
            sentences.append(
                f"{who} has not confirmed the erasure {erasure.erasure_id[:16]}... of {erasure.records} records, "
                f"asked for {erasure.age_s} s ago. Next step: start it, or see its log."
            )
        if len(entry.overdue) > _SHOWN_COUNT:
            sentences.append(f"... and {len(entry.overdue) - _SHOWN_COUNT} more overdue erasures; --json lists them.")
    return sentences


def _name(found: str | FrameName | PartName) -> str:
    if isinstance(found, str):
        return found
    return f"{found.record} frame {found.frame}" if isinstance(found, FrameName) else found.record


def _shown(found: Sequence[str | FrameName | PartName]) -> str:
    ids = [_name(each) for each in found]
    return ", ".join(ids[:_SHOWN_COUNT]) + (", ..." if len(ids) > _SHOWN_COUNT else "")


def _count(report: ScrubAnswer | RebuildAnswer, field: str) -> int:
    return report.counts.get(field, len(getattr(report, field)))


def scrub_sentences(node: str, report: ScrubAnswer) -> list[str]:
    without = report.records_count - report.clips_compared_count
    others = f" (of the other {without} nothing is to be here, or it is named below)" if without > 0 else ""
    sentences = [
        f"{node}, at height {report.height}: {report.records_count} records of the chain looked up"
        f"{f' after {report.after}' if report.after else ''}, "
        f"{report.clips_compared_count} clips{others} and {report.frames_compared_count} frames read."
    ]
    for field, (sentence, step) in _SCRUB_FINDINGS.items():
        found = getattr(report, field)
        if found:
            shown = "" if field == "unclaimed_keys" else _shown(found)
            sentences.append("  " + f"{sentence} {step}".format(count=_count(report, field), ids=shown, node=node))
    if report.dirty_slots_count:
        sentences.append(
            f"  {report.dirty_slots_count} empty slots of the erase keys hold bytes; restart {node} to wipe them"
        )
    if report.log_bytes or report.dirty_bytes:
        sentences.append(f"  the database's log keeps {report.log_bytes} bytes, its free pages {report.dirty_bytes}")
    if report.nothing_erased_is_left:
        behind = f" among the records after {report.after}" if report.after else ""
        sentences.append(f"  Of what was erased{behind}, no ciphertext and no key is left here.")
        if report.dirty_bytes is None:
            sentences.append(
                "  (The files of the database's server cannot be looked into from here; see docs/how-to/mongodb.md.)"
            )
    return sentences


def rebuild_sentences(node: str, report: RebuildAnswer) -> list[str]:
    done = [
        (_count(report, "erased_again"), "records erased again, as the chain says"),
        (_count(report, "corrected"), "records set right"),
        (_count(report, "forgotten"), "clips or marks dropped that were not what the chain says"),
        (report.keys_destroyed_count, "erase keys destroyed that belonged to no frame"),
        (report.fetched_count, "clips fetched from other custodians"),
        (_count(report, "mended"), "clips mended with another custodian's copy"),
    ]
    sentences = [f"{node}, at height {report.height}: {report.clips_count} clips looked at."]
    sentences += [f"  {count} {what}" for count, what in done if count]
    if report.still_missing_count:
        sentences.append(f"  {report.still_missing_count} clips are still missing: no custodian in touch has them.")
    if report.still_damaged:
        sentences.append(f"  {_count(report, 'still_damaged')} clips are still damaged: nobody has a sound copy.")
    if report.unknown_to_chain:
        sentences.append(f"  {_count(report, 'unknown_to_chain')} clips are not of this chain; they were left alone.")
    if report.ok:
        sentences.append("  The store has what the chain says, and nothing else.")
    return sentences


def _robot_name(row: RobotUploads) -> str:
    return f"Robot {row.robot[:16]}... of {row.organisation or 'no organisation'}"


def find_upload_problems(answer: UploadReport) -> list[UploadProblem]:
    problems: list[UploadProblem] = []
    if answer.uploads_paused:
        free, reserve = ((size or 0) // _MIB for size in (answer.disk_free_bytes, answer.disk_reserve_bytes))
        problems.append(("UPLOADS_PAUSED", f"It takes no uploads: {free} MiB are free, {reserve} MiB are kept back."))
    elif answer.days_until_reserve is not None and answer.days_until_reserve < RESERVE_LEFT_MIN_DAYS:
        rate = answer.bytes_a_day / 1e9
        sentence = f"At {rate:.1f} GB a day its disk reaches the reserve in {answer.days_until_reserve} days."
        problems.append(("DISK_FILLS_UP", sentence))
    for row in answer.uploads:
        if row.refused_lately:
            codes = ", ".join(f"{code} {count}" for code, count in row.refused_lately.items())
            refused = f"uploads lately ({codes}), {row.refused} since the custodian's start"
            sentence = f"{_robot_name(row)} was refused {refused}."
            problems.append(("UPLOADS_REFUSED", sentence))
        used = _quotas_used(row, answer.quotas)
        name, share = max(used.items(), key=lambda item: item[1])
        if row.robot and share >= NEAR_SHARE:
            problems.append(("UPLOAD_QUOTA_NEAR", f"{_robot_name(row)} has used {share:.0%} of {name}."))
    return problems


def _quotas_used(row: RobotUploads, quotas: dict[str, int]) -> dict[str, float]:
    return {
        "robot_staged_max_count": row.staged_clips / quotas["robot_staged_max_count"],
        "robot_staged_max_mib": row.staged_bytes / _MIB / quotas["robot_staged_max_mib"],
        "robot_day_max_mib": row.today_bytes / _MIB / quotas["robot_day_max_mib"],
    }
