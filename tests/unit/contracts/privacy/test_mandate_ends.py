"""The end that a mandate names is one for its proposal, too."""

from __future__ import annotations

from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital
from tests.unit.contracts.privacy.test_mandates import Family


def test_nobody_agrees_to_a_mandate_whose_time_is_over(hospital: Hospital) -> None:
    family = Family(hospital)
    until_ms = hospital.bucket() + DAY_MS
    proposed = family.propose(until_ms=until_ms)
    hospital.time_ms = until_ms - 100
    assert family.refusal(family.second, "approve", proposed) == "MANDATE_LAPSED"
