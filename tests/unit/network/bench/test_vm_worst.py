"""What gas buys is measured over programs that use it; the figures are those of a run of a few of them."""

from __future__ import annotations

import ast

import pytest
from click.testing import CliRunner

from network.bench.vm.vm_worst import PROGRAMS, run_worst_benchmark, run_worst_search
from network.cli.main import main
from network.lab.hostile.measuring import cheapest_first, measure_program
from network.lab.hostile.micro import MICRO
from network.lab.hostile.program import body, bomb, refused
from network.lab.hostile.searching import Breeder

LOOP = body("loop", "OUT_OF_GAS", "while True:\n    pass")
HOARD = body("hoard", "MEMORY_BUDGET", "x = []\nwhile True:\n    x.append(bytes(1000))")


def test_every_builtin_method_and_host_function_has_a_program():
    from contracts.vm.builtins.host import HOST_FUNCTIONS
    from contracts.vm.builtins.methods import METHODS
    from contracts.vm.frontend.name_binding import BUILTINS

    text = "\n".join(program.source for program in MICRO)
    names = (set(BUILTINS) | set(HOST_FUNCTIONS)) - {"charge_source", "check_source"}
    assert {name for name in names if f"{name}(" not in text} == set()
    assert {name for name in METHODS if f".{name}(" not in text} == set()


def test_every_construct_has_a_program_and_the_whole_corpus_is_measured():
    used = {type(node).__name__ for program in MICRO for node in ast.walk(ast.parse(program.source))}
    operators = {kind.__name__ for base in (ast.operator, ast.cmpop, ast.unaryop) for kind in base.__subclasses__()}
    assert operators - used == {"Div", "MatMult"}
    blocks = {"If", "For", "While", "Break", "Continue", "Pass", "Delete", "AugAssign", "AnnAssign", "Return"}
    assert (blocks | {"ListComp", "DictComp", "GeneratorExp", "JoinedStr", "IfExp", "BoolOp", "Slice"}) - used == set()
    assert len({program.name for program in PROGRAMS}) == len(PROGRAMS) > 700
    prices = [measure_program(program, rounds=1) for program in (LOOP, HOARD)]
    assert [price.name for price in cheapest_first(price for price in prices if price)] == ["loop"]


@pytest.mark.long
def test_a_table_of_programs_dearest_first():
    result = run_worst_benchmark(
        [LOOP, HOARD, refused("no", "FLOAT", "return 1 / 2"), bomb("bomb", "x = [0] * 2 ** 90")]
    )
    assert result.name == "vm-worst"
    assert [program.name for program in result.programs] in (["loop"], ["loop", "hoard"], ["hoard", "loop"])
    assert result.figures.cheapest == "loop"
    assert result.figures.ratio > 0
    assert result.figures.block_max_ms == 125
    assert result.conditions["language"] >= 2


def test_a_search_is_named_by_its_seed_and_reaches_everything():
    one, same, other = (Breeder(seed) for seed in (4, 4, 5))
    drawn = [breeder.change(breeder.cross(breeder.new(), breeder.new())) for breeder in (one, same, other)]
    assert drawn[0] == drawn[1] != drawn[2]
    steps = "\n".join(one.step() for _ in range(4000))
    from contracts.vm.builtins.methods import METHODS
    from contracts.vm.frontend.name_binding import CALLABLES

    assert {name for name in METHODS if f".{name}(" not in steps} == set()
    assert {
        name for name in set(CALLABLES) - {"charge_source", "check_source", "require"} if f"{name}(" not in steps
    } == set()


def test_a_search_tells_the_dearest_with_their_sources():
    told: list[str] = []
    result = run_worst_search(0.01, 1, told.append)
    assert result.figures.programs >= result.figures.counted > 0
    prices = [program.ms_per_million_gas for program in result.programs]
    assert prices == sorted(prices, reverse=True) != []
    assert all("while True:" in program.source for program in result.programs)


@pytest.mark.parametrize("given", [["--search", "1"], ["--worst", "--search", "0"]])
def test_a_search_needs_a_time_and_the_word(given):
    answer = CliRunner().invoke(main, ["bench", "vm", *given])
    assert answer.exit_code == 2
