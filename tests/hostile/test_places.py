"""No method, and no function of the state, is far dearer at one place, or after what a block did before, than it pays for.

The bound is four times that of `bench vm --worst`, since this machine does other work too: what was not charged at all
was beyond a hundred.
"""

from __future__ import annotations

import pytest

from contracts.vm.builtins.host import HOST_FUNCTIONS
from contracts.vm.builtins.methods import METHODS
from network.bench.vm.vm_worst import RATIO_MAX
from network.lab.hostile.measuring import measure_program
from network.lab.hostile.places import DICT_STEPS, HOST_STEPS, LIST_STEPS, PLACES, STATE_STEPS, TEXT_STEPS, TUPLE_STEPS
from network.lab.hostile.program import SPENT, body

GAS_LIMIT = 120_000
ROUNDS_COUNT = 6
LOADED_RATIO_MAX = 4 * RATIO_MAX
REFERENCE = body("reference", SPENT, "while True:\n    pass\n    pass\n    pass\n    pass")
TABLES = {list: LIST_STEPS, tuple: TUPLE_STEPS, dict: DICT_STEPS, str: TEXT_STEPS, bytes: TEXT_STEPS}


def test_every_method_and_function_of_the_state_has_a_row():
    missing = {(name, kind) for name, kinds in METHODS.items() for kind in kinds if name not in TABLES.get(kind, name)}
    assert missing == set()
    assert {name for name in HOST_FUNCTIONS if name.startswith("state.")} <= STATE_STEPS.keys()
    elsewhere = {"emit", "call", "charge_source", "check_source"}
    assert {name for name in HOST_FUNCTIONS if not name.startswith("state.")} == HOST_STEPS.keys() | elsewhere
    text = "\n".join(program.source for program in PLACES)
    assert {name for name in METHODS if f".{name}(" not in text} == {"bit_length", "to_bytes"}


def seconds(program) -> float:
    price = measure_program(program, rounds=1, gas_limit=GAS_LIMIT)
    return 0.0 if price is None else price.seconds_per_million_gas


@pytest.mark.parametrize("kind", ["list", "tuple", "dict", "text", "wide-text", "bytes", "state", "host"])
def test_no_place_is_far_dearer_than_its_gas(kind):
    bound = LOADED_RATIO_MAX * min(seconds(REFERENCE) for _ in range(ROUNDS_COUNT))
    programs = [program for program in PLACES if program.name.startswith(f"place-{kind}")]
    assert len(programs) >= 15
    dear = [program for program in programs if seconds(program) > bound]
    sure = {program.name: min(seconds(program) for _ in range(ROUNDS_COUNT)) for program in dear}
    assert {name: round(least, 2) for name, least in sure.items() if least > bound} == {}
