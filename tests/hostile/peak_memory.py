"""Runs programs, each in a process that may take no more than four times a call's budget; prints what each took.

Started as `python -m tests.hostile.peak_memory PART PARTS`: runs every PARTS-th program from PART on and prints one JSON
object. The process that is made for a program is one that a worker would be: all is loaded, nothing of a call is in it.
"""
# ruff: noqa: E501 - tables of short programs read better in long lines

from __future__ import annotations

import gc
import json
import os
import random
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from contracts.lifecycle.applying_changes import MIGRATION_GAS_MAX
from contracts.vm import ContractSourceError, InternalFault
from contracts.vm.builtins.builtins_table import BUILTINS
from contracts.vm.builtins.methods import METHODS
from contracts.vm.model.meter import MEMORY_MAX_BYTES
from network.lab.hostile.families import CORPUS
from network.lab.hostile.micro import HELPERS, MICRO, STATE
from network.lab.hostile.program import REFUSED, SPENT, Program, body
from network.lab.hostile.running import CallHost, call_program, compile_program, make_state
from network.lab.hostile.searching import ARGUMENTS, ONLY_BY_NAME, OTHER, SIGNS, TYPE_LETTERS, Breeder

FACTOR = 4
ROOM_BYTES = FACTOR * MEMORY_MAX_BYTES
KINDS = {"ascii": "a", "latin": "\\xe9", "two": "\\u0161", "four": "\\U0001f600"}
SIZES = (1, 1000, 60_000, 1_000_000)
DRAWN_COUNT = 1500
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def _values(letter: str, size: int, step: str) -> str:
    """Return the values that a step uses, their texts of this letter, each in about this many modelled bytes."""
    texts, items, entries = max(size // (1 if letter == "a" else 4), 1), max(size // 24, 1), max(size // 200, 1)
    made = {
        "s0": f"'{letter}' * {texts}", "s1": f"'{letter}'", "s2": f"'a' * {texts}", "b0": f"b'a' * {size}", "b1": "b'a'",
        "i0": "2 ** 255", "i1": str(min(size, 9)), "l0": f"[2 ** 255] * {items}", "l1": f"['{letter}'] * {items}",
        "t0": f"(1,) * {items}", "r0": f"range({items})", "d0": f"{{i: i for i in range({min(entries, 250)})}}",
    }  # fmt: skip
    return "".join(f"{name} = {value}\n" for name, value in made.items() if name in step)


def _steps() -> Iterator[tuple[str, str]]:
    """Yield an expression for each method of each type, each function, each sign, and what else makes values."""

    def fill(text: str, same: str) -> str:
        for hole, slot in (("any", "l1"), ("same", f"{same}0"), ("key", "0"), ("few", "3"), ("stored", "large")):
            text = text.replace(f"{{{hole}}}", slot)
        for letter in "sbiltdr":
            text = text.replace(f"{{{letter}}}", f"{letter}0")
        return text

    def argument(name: str, same: str, place: int) -> str:
        choices = ARGUMENTS.get(name, ("{same}", f"{same}1") if same in "sb" else ("{any}",))
        return ONLY_BY_NAME.get(name) or fill(choices[place % len(choices)], same)

    for name, table in sorted(METHODS.items()):
        for kind, method in table.items():
            letter = TYPE_LETTERS[kind]
            for place in range(3):
                given = ", ".join(argument(param, letter, place) for param in method.params)
                yield f"{letter}.{name}-{place}", f"{letter}0.{name}({given})"
    for name, function in sorted(BUILTINS.items()):
        for place, letter in enumerate("sbliltdr"):
            given = ", ".join([f"{letter}0", *(argument(param, letter, place) for param in function.params[1:])])
            yield f"{name}-{place}", f"{name}({given})"
    for sign in SIGNS:
        for pair in ("s0 s0", "s0 s2", "s2 s1", "b0 b0", "l0 l0", "t0 t0", "s0 i1", "l0 i1", "s1 s0", "l1 l0"):
            left, right = pair.split()
            yield f"{left} {sign} {right}", f"{left} {sign} {right}"
    yield from (
        ("f-string", "f'{s0}{s0}{s2}{s1}{i0}'"), ("slice", "s0[1:]"), ("slice-list", "l0[1:]"), ("list", "[v for v in l0]"),
        ("list-of-huge", "[2 ** 255 + v for v in r0]"), ("dict", "{v: 2 ** 255 + v for v in r0}"), ("pairs", "[(v, i0 - v) for v in r0]"),
        ("letters", "[v for v in s0]"), ("shared", "[[s0, l0], [s0, l0]]"), ("passed", "call('other', 'f', l0)"),
        ("passed-texts", "call('other', 'f', [s0, s0])"), ("scanned", "state.scan(b'', 256)"), ("stored", "state.get(b'wide')"),
        ("put", "state.put(b'k', [{}] * 9999)"), ("displayed", "[i0 - 1, i0 - 2, i0 - 3, i0 - 4, i0 - 5, i0 - 6]"),
    )  # fmt: skip


def programs() -> Iterator[Program]:
    """Yield all programs: every step in every size and width of text, kept and again; the corpus; some of the search."""
    large = {b"q" + n.to_bytes(2, "big"): b"v" * 16_000 for n in range(256)}
    for kind, letter in KINDS.items():
        for size in SIZES:
            for name, step in _steps():
                for manner, text in (("kept", f"kept.append({step})"), ("once", f"x = {step}")):
                    source = f"kept = []\n{_values(letter, size, step)}while True:\n    {text}"
                    state = {**STATE, **(large if "scan" in step else {})}
                    yield body(
                        f"{name} {kind} {size} {manner}",
                        SPENT,
                        source,
                        before=HELPERS,
                        others={"other": OTHER},
                        state=state,
                    )
    yield body("list-filled", SPENT, "x = [0] * 300000\nfor i in range(300000):\n    x[i] = 2 ** 255 + i")
    yield from (program for program in (*CORPUS, *MICRO) if not program.expect.startswith(REFUSED))
    breeder = Breeder(1)
    yield from (breeder.new().program(f"drawn-{number}") for number in range(DRAWN_COUNT))


def _status(name: str) -> int:
    """Return a figure of this process in bytes."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(name):
            return int(line.split()[1]) * 1024
    raise AssertionError(name)


def run_bounded(program: Program) -> dict[str, Any]:
    """Run a program in a forked process with room for so much more than it has; return what it came to and took at most."""
    compiled = compile_program(program)
    host = CallHost(make_state(program))
    host.begin()
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins anew
        before = _status("VmRSS")
        room = _status("VmSize") + ROOM_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
        try:
            code = call_program(program, compiled, host, MIGRATION_GAS_MAX).code
        except (InternalFault, MemoryError) as error:
            code = f"FAILED {error}"
        os.write(writing, json.dumps({"code": code, "peak": _status("VmHWM") - before}).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        told = pipe.read()
    os.waitpid(child, 0)
    return json.loads(told) if told else {"code": "FAILED without a word", "peak": ROOM_BYTES}


def main() -> None:
    """Run a part of the programs and print what was found."""
    part, parts = int(sys.argv[1]), int(sys.argv[2])
    chosen = list(programs())
    random.Random(5).shuffle(chosen)
    ran, failed, peaks = 0, [], []
    gc.collect()
    gc.freeze()
    for program in chosen[part::parts]:
        try:
            told = run_bounded(program)
        except ContractSourceError:
            continue
        ran += told["code"] in ("OUT_OF_GAS", "MEMORY_BUDGET", "OK")
        peaks.append((told["peak"], program.name))
        if told["code"].startswith("FAILED"):
            failed.append([program.name, told["code"]])
    peaks.sort(reverse=True)
    highest = [[name, round(peak / MEMORY_MAX_BYTES, 2)] for peak, name in peaks[:15]]
    sys.stdout.write(json.dumps({"programs": len(peaks), "ran": ran, "failed": failed, "highest": highest}) + "\n")


if __name__ == "__main__":
    main()
