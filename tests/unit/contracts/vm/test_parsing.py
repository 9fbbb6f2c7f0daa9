"""A failure of Python's parser is told from a refusal of a source, and nothing comes in between while it parses."""

from __future__ import annotations

import ast
import gc
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from contracts.lifecycle import changed_calls
from contracts.vm import InternalFault, compile_contract
from contracts.vm.compiler.compile_cache import check_once
from contracts.vm.frontend.parser import parse_alone, parse_source

SOURCE = '''
@view
def look(data: bytes) -> list:
    """Look."""
    return [[1, [2, [3, [4]]]], {"a": ((1 + 2) * 3) - 4}]
'''
_parse = ast.parse


@pytest.fixture(autouse=True)
def collecting() -> Iterator[None]:
    was = gc.isenabled()
    gc.enable()
    yield
    (gc.enable if was else gc.disable)()


def failing(times: int, error: Exception) -> Callable[..., Any]:
    left = [times]

    def parse(*args: Any, **kwargs: Any) -> ast.AST:
        assert not gc.isenabled()
        if left[0]:
            left[0] -= 1
            raise error
        return _parse(*args, **kwargs)

    return parse


ERRORS = [
    SystemError("AST constructor recursion depth mismatch (before=48, after=50)"),
    MemoryError(),
    RecursionError(),
]


@pytest.mark.parametrize("error", ERRORS)
def test_a_parser_that_fails_once_is_asked_once_more(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(ast, "parse", failing(1, error))
    assert isinstance(parse_source(SOURCE), ast.Module)
    assert gc.isenabled()


@pytest.mark.parametrize("error", ERRORS)
def test_a_parser_that_fails_twice_gives_no_verdict_and_nothing_is_remembered(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    source = SOURCE + f"# {type(error).__name__}\n"
    with monkeypatch.context() as patched:
        patched.setattr(ast, "parse", failing(2, error))
        with pytest.raises(InternalFault, match=type(error).__name__):
            check_once(source)
        assert gc.isenabled()
    assert check_once(source).abi.entries


def test_the_types_of_an_interface_are_parsed_in_the_same_way(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = "dict[str, list[int]]"
    changed_calls._accepts.cache_clear()
    monkeypatch.setattr(ast, "parse", failing(2, ERRORS[0]))
    with pytest.raises(InternalFault):
        changed_calls._accepts(kind)
    assert changed_calls._accepts(kind)({"a": [1]})


def test_a_wrong_source_is_still_refused_and_the_collector_as_it_was() -> None:
    assert not isinstance(parse_source("def f(:\n"), ast.Module)
    assert gc.isenabled()
    gc.disable()
    parse_alone("1", "eval")
    assert not gc.isenabled()


def test_parses_in_many_threads_and_in_finalizers_disturb_none() -> None:
    """What CPython 3.11 gets wrong: a collection inside a parse runs a finalizer that parses, or lets a thread in."""

    class Parsing:
        def __init__(self) -> None:
            self.itself = self

        def __del__(self) -> None:
            parse_alone("f(g(h(1)))", "eval")

    wrong: list[BaseException] = []

    def work() -> None:
        try:
            for _ in range(60):
                Parsing()
                assert compile_contract(SOURCE, "contract").abi.entries
        except BaseException as error:  # noqa: BLE001 - the test tells
            wrong.append(error)

    def on_collection(_phase: str, _info: dict[str, int]) -> None:
        parse_alone("[1, [2, [3]]]", "eval")

    before = gc.get_threshold()
    gc.set_threshold(5, 2, 2)
    gc.callbacks.append(on_collection)
    try:
        threads = [threading.Thread(target=work) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        gc.callbacks.remove(on_collection)
        gc.set_threshold(*before)
    assert wrong == []
