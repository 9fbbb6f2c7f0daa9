"""Custodians' answers about uploads as plain sentences."""

from __future__ import annotations

from typing import Literal

from node.custody.chain.custody_answers import RobotUploads, UploadReport

NEAR_SHARE = 0.8
DAYS_LEFT_MIN = 7
_MIB = 1024 * 1024

UploadProblem = tuple[Literal["UPLOADS_PAUSED", "DISK_FILLS_UP", "UPLOADS_REFUSED", "UPLOAD_QUOTA_NEAR"], str]


def _name(row: RobotUploads) -> str:
    return f"Robot {row.robot[:16]}... of {row.organisation or 'no organisation'}"


def find_upload_problems(answer: UploadReport) -> list[UploadProblem]:
    problems: list[UploadProblem] = []
    if answer.uploads_paused:
        free, reserve = ((size or 0) // _MIB for size in (answer.disk_free_bytes, answer.disk_reserve_bytes))
        problems.append(("UPLOADS_PAUSED", f"It takes no uploads: {free} MiB are free, {reserve} MiB are kept back."))
    elif answer.days_until_reserve is not None and answer.days_until_reserve < DAYS_LEFT_MIN:
        rate = answer.bytes_a_day / 1e9
        sentence = f"At {rate:.1f} GB a day its disk reaches the reserve in {answer.days_until_reserve} days."
        problems.append(("DISK_FILLS_UP", sentence))
    for row in answer.uploads:
        if row.refused_lately:
            refused = f"{row.refused_lately} uploads lately, {row.refused} since the custodian's start"
            sentence = f"{_name(row)} was refused {refused}."
            problems.append(("UPLOADS_REFUSED", sentence))
        used = _quotas_used(row, answer.quotas)
        name, share = max(used.items(), key=lambda item: item[1])
        if row.robot and share >= NEAR_SHARE:
            problems.append(("UPLOAD_QUOTA_NEAR", f"{_name(row)} has used {share:.0%} of {name}."))
    return problems


def _quotas_used(row: RobotUploads, quotas: dict[str, int]) -> dict[str, float]:
    return {
        "robot_staged_max_count": row.staged_clips / quotas["robot_staged_max_count"],
        "robot_staged_max_mib": row.staged_bytes / _MIB / quotas["robot_staged_max_mib"],
        "robot_day_max_mib": row.today_bytes / _MIB / quotas["robot_day_max_mib"],
    }
