"""How far back nodes keep blocks, for `status` and `doctor`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pages.time_format import format_time

_HELD = {
    "custodian": "; older ones than due, since its custodian has not followed them yet",
    "record": "; older ones than due, for a record that is kept for a claim",
}


def kept_lines(statuses: Mapping[str, Mapping[str, Any] | None]) -> list[str]:
    groups: dict[str, list[str]] = {}
    for name, status in statuses.items():
        if status is None or "blocks_kept" not in status:
            continue
        kept = status["blocks_kept"]
        since = "" if kept["earliest_ms"] is None else f" ({format_time(kept['earliest_ms'])})"
        what = f"from {status['earliest_height']}{since} on{', as an archive' if kept['archive'] else ''}"
        groups.setdefault(what + _HELD.get(kept["held_by"], ""), []).append(name)
    return [f"{', '.join(names)}: blocks {what}." for what, names in groups.items()]
