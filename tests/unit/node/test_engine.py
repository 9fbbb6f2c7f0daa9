"""The engine carries effects out in order: nothing is said before it is journalled, and a full disk silences the node."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

from consensus.block import QuorumCertificate
from consensus.effects import TIMER_ROUND, Broadcast, CancelTimer, Effect, Persist, SetTimer
from consensus.errors import BlockRobotError
from consensus.events import Event, Started, TimerFired, WorkChanged
from consensus.messages import CertificateNotice
from node.engine import Engine

NOTICE = CertificateNotice(qc=QuorumCertificate(epoch=0, round=0, block_id=bytes(32), votes=()), entered_by=None)


class ScriptedCore:
    """Answers the events with the effects of a script, one after another."""

    def __init__(self, *script: list[Effect]) -> None:
        self.script = list(script)
        self.events: list[Event] = []
        self.halted = ""

    def handle(self, event: Event) -> list[Effect]:
        self.events.append(event)
        return self.script.pop(0) if self.script else []


class Stage:
    """Journal, outbox and executor in one, writing down what happened."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.refuses = False
        self.size_bytes = 0
        self.thread = None
        self.gate: threading.Event | None = None

    def append(self, record: bytes, kind: int = 0) -> int:
        self.told.append(f"append {record.decode()}")
        return 1

    def sync(self) -> int:
        if self.gate is not None:
            self.gate.wait(10)
        if self.refuses:
            raise BlockRobotError("JOURNAL_UNWRITABLE")
        self.told.append("sync")
        return 1

    def broadcast(self, message: Any) -> None:
        self.told.append("broadcast")


def _engine(core: ScriptedCore, stage: Stage) -> Engine:
    nothing: Any = None
    return Engine(
        core=core,  # type: ignore[arg-type]
        start=nothing,
        make_core=nothing,
        executor=stage,  # type: ignore[arg-type]
        mempool=nothing,
        journal=stage,  # type: ignore[arg-type]
        sink=nothing,
        clock=lambda: 1,
    )


async def test_what_stands_behind_a_record_is_said_after_the_sync() -> None:
    stage = Stage()
    core = ScriptedCore([Persist((b"a", b"b")), Broadcast(NOTICE), Persist((b"c",)), Broadcast(NOTICE)])
    _engine(core, stage).start(stage)  # type: ignore[arg-type]
    assert stage.told == ["append a", "append b", "sync", "broadcast", "append c", "sync", "broadcast"]


async def test_a_node_whose_journal_fails_says_nothing_ever_again() -> None:
    stage = Stage()
    stage.refuses = True
    core = ScriptedCore([Persist((b"a",)), Broadcast(NOTICE)], [Broadcast(NOTICE)])
    engine = _engine(core, stage)
    engine.start(stage)  # type: ignore[arg-type]
    engine.submit(WorkChanged(pending=True, now_ms=1))
    assert stage.told == ["append a"]
    assert engine.fault
    assert not engine.is_signing
    assert [type(event) for event in core.events] == [Started]


async def test_on_a_slow_disk_the_loop_goes_on_and_the_order_is_kept() -> None:
    stage = Stage()
    stage.gate = threading.Event()
    core = ScriptedCore([Persist((b"a",)), Broadcast(NOTICE)], [Broadcast(NOTICE)])
    engine = _engine(core, stage)
    engine._sync_ms = 50.0
    engine.start(stage)  # type: ignore[arg-type]
    engine.submit(WorkChanged(pending=True, now_ms=1))
    await asyncio.sleep(0)
    assert stage.told == ["append a"]
    assert len(core.events) == 1
    stage.gate.set()
    await engine.stop_waiting()
    assert stage.told == ["append a", "sync", "broadcast", "broadcast"]
    assert [type(event) for event in core.events] == [Started, WorkChanged]


async def test_a_timer_comes_back_with_its_round_and_a_cancelled_one_does_not() -> None:
    stage = Stage()
    core = ScriptedCore([SetTimer(TIMER_ROUND, 7, 0), SetTimer("other", 8, 0), CancelTimer("other")])
    engine = _engine(core, stage)
    engine.start(stage)  # type: ignore[arg-type]
    for _ in range(5):
        await asyncio.sleep(0)
    assert core.events[1:] == [TimerFired(kind=TIMER_ROUND, round=7, now_ms=1)]


async def test_an_action_between_events_waits_for_a_running_sync() -> None:
    stage = Stage()
    stage.gate = threading.Event()
    core = ScriptedCore([Persist((b"a",))])
    engine = _engine(core, stage)
    engine._sync_ms = 50.0
    engine.start(stage)  # type: ignore[arg-type]
    engine.call_between_events(lambda: stage.told.append("action"))
    assert "action" not in stage.told
    stage.gate.set()
    await engine.stop_waiting()
    assert stage.told == ["append a", "sync", "action"]
