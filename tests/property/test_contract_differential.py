"""What the language accepts runs the same under plain CPython: random programs, both ways, one outcome."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.property.both_ways import arguments_of, compare, digest_of_programs
from tests.property.contract_programs import ProgramWriter


def check_programs(examples: int) -> None:
    seen: dict[str, int] = {}

    @settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.randoms(use_true_random=False))
    def every_program_ends_the_same(random: Random) -> None:
        source = ProgramWriter(random).program()
        code = compare(source, arguments_of(random))
        seen[code] = seen.get(code, 0) + 1

    every_program_ends_the_same()
    assert seen.get("OK", 0) > sum(seen.values()) / 20, seen
    assert len(seen) >= 5, seen


def test_programs_end_the_same_under_plain_python():
    check_programs(150)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_many_programs_end_the_same_under_plain_python():
    check_programs(5_000)
    assert len(digest_of_programs(20_000)) == 64
