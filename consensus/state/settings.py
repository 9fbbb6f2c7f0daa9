"""State of the contract `settings`: decided upload quotas and copies of a clip; the rest is in `producers`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from consensus.primitives.encoding import Wire, decode_value
from consensus.state.keys import TEXT, Prefix

SETTINGS = "settings"

QUOTA: Prefix[int] = Prefix(SETTINGS, "quota/", (TEXT,), int)
"""By the name of a setting; while nobody decided it its default holds."""
LAYOUT = (QUOTA,)
CUSTODY_COPIES = "custody_copies"
"""How many custodians keep a clip; 0: as `Placement` says."""


class UploadQuotas(Wire, frozen=True):
    """The quotas in force, by the names of their settings; staged: not yet recorded, day: UTC, by the chain's time."""

    robot_staged_max_mib: int = 512
    robot_staged_max_count: int = 4_096
    robot_day_max_mib: int = 204_800
    organisation_staged_max_mib: int = 8_192
    organisation_staged_max_count: int = 65_536
    organisation_day_max_mib: int = 2_097_152


QUOTA_NAMES: tuple[str, ...] = UploadQuotas.__struct_fields__


def read_quotas(get: Callable[[bytes], bytes | None]) -> UploadQuotas:
    found = {name: get(QUOTA.key(name)) for name in QUOTA_NAMES}
    return quotas_of({name: decode_value(value) for name, value in found.items() if value is not None})


def read_copies(get: Callable[[bytes], bytes | None]) -> int:
    value = get(QUOTA.key(CUSTODY_COPIES))
    return 0 if value is None else int(decode_value(value))


def quotas_of(decided: Mapping[str, Any]) -> UploadQuotas:
    return UploadQuotas(**decided)
