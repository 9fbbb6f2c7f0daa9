"""The metrics name the robots that bring most, and no more lines than that however many robots there are."""

from __future__ import annotations

from typing import Any

from prometheus_client.parser import text_string_to_metric_families

from node.custody.coordination.custody_answers import RobotUploads, UploadReport
from node.custody.coordination.upload_report import OTHER_ROBOTS, ROBOTS_IN_METRICS_MAX_COUNT, render_uploads

QUOTAS = {"robot_staged_max_mib": 512, "robot_staged_max_count": 4096, "robot_day_max_mib": 3}


def row(number: int, **changes: Any) -> RobotUploads:
    told = {"staged_clips": 1, "staged_bytes": 10, "today_bytes": 100 + number, "refused": 0}
    others = {"bytes_a_day": 0, "refused_lately": {}}
    return RobotUploads(**{"robot": f"{number:066x}", "organisation": "hospital", **told, **others, **changes})


def read(*rows: RobotUploads, free: int | None = 5, reserve: int | None = 2) -> dict[tuple[str, str], float]:
    report = UploadReport(
        uploads=list(rows),
        quotas=QUOTAS,
        bytes_a_day=0,
        disk_free_bytes=free,
        disk_reserve_bytes=reserve,
        uploads_paused=False,
        days_until_reserve=None,
    )
    families = text_string_to_metric_families(render_uploads(report).decode())
    samples = [sample for family in families for sample in family.samples]
    return {(s.name, s.labels.get("robot", s.labels.get("quota", ""))): s.value for s in samples}


def test_each_robot_has_its_bytes_and_the_quotas_stand_beside() -> None:
    told = read(row(7, staged_bytes=4096, refused=3))
    robot = f"{7:066x}"
    assert told["blockrobot_uploads_staged_bytes", robot] == 4096
    assert told["blockrobot_uploads_today_bytes", robot] == 107
    assert told["blockrobot_uploads_refused", robot] == 3
    assert told["blockrobot_upload_quota_bytes", "robot_day_max_mib"] == 3 * 1024 * 1024
    assert told["blockrobot_upload_quota_clips", "robot_staged_max_count"] == 4096
    assert (told["blockrobot_custody_disk_free_bytes", ""], told["blockrobot_custody_disk_reserve_bytes", ""]) == (5, 2)


def test_lines_are_bounded_and_there_is_none_for_what_is_unknown() -> None:
    count = ROBOTS_IN_METRICS_MAX_COUNT + 10
    told = read(*(row(number) for number in range(1, count + 1)))
    lines = {robot: value for (name, robot), value in told.items() if name == "blockrobot_uploads_today_bytes"}
    assert len(lines) == ROBOTS_IN_METRICS_MAX_COUNT + 1
    assert lines[f"{count:066x}"] == 100 + count, "who brought most is named"
    assert lines[OTHER_ROBOTS] == sum(100 + number for number in range(1, 11))
    told = read(row(1, robot=""), free=None, reserve=None)
    assert not any(name.startswith(("blockrobot_uploads_", "blockrobot_custody_disk")) for name, _ in told)
