"""The engine carries effects out in order: nothing is said before it is journalled, and a full disk silences the node."""

from __future__ import annotations

import asyncio
import threading
from types import SimpleNamespace
from typing import Any

from consensus.chain.block import QuorumCertificate
from consensus.chain.messages import CertificateNotice, Timeout
from consensus.errors import BlockRobotError
from consensus.protocol.effects import TIMER_ROUND, Broadcast, CancelTimer, Effect, Persist, SetTimer
from consensus.protocol.events import Event, NoticeReceived, Started, TimerFired, WorkChanged
from node.consensus.engine import Engine
from node.mempool.quarantine import Quarantine
from tests.virtual_time import in_virtual_time

NOTICE = CertificateNotice(qc=QuorumCertificate(epoch=0, round=0, block_id=bytes(32), votes=()), entered_by=None)


class ScriptedCore:
    """Answers the events with the effects of a script, one after another."""

    def __init__(self, *script: list[Effect]) -> None:
        self.script = list(script)
        self.events: list[Event] = []
        self.halted = ""
        self.lockout = None

    def handle(self, event: Event) -> list[Effect]:
        self.events.append(event)
        return self.script.pop(0) if self.script else []

    def journal_snapshot(self) -> tuple[bytes, ...]:
        return (b"all that was said",)


class Stage:
    """Journal, outbox and executor in one, writing down what happened."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.refuses = False
        self.size_bytes = 0
        self.thread = None
        self.schedule = SimpleNamespace(producers=())
        self.quarantine = Quarantine(lambda: 0.0)
        self.gate: threading.Event | None = None
        self.has_calls = False

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

    def recover(self, keep: Any) -> None:
        if self.refuses:
            raise BlockRobotError("JOURNAL_UNWRITABLE")
        self.told.append(f"recover {[record.decode() for _, record in keep]}")

    def has_work(self, *_: Any) -> bool:
        return self.has_calls

    def broadcast(self, message: Any) -> None:
        self.told.append("broadcast")

    def gossip_again(self) -> None:
        self.told.append("gossip")


def _engine(core: ScriptedCore, stage: Stage) -> Engine:
    nothing: Any = None
    return Engine(
        core=core,  # type: ignore[arg-type]
        start=nothing,
        make_core=nothing,
        executor=stage,  # type: ignore[arg-type]
        mempool=stage,  # type: ignore[arg-type]
        journal=stage,  # type: ignore[arg-type]
        sink=nothing,
        clock=lambda: 1,
    )


async def _until_it_writes(engine: Engine) -> None:
    """The journal is written in a thread, which virtual time does not wait for."""
    while engine.fault:  # noqa: ASYNC110 - nothing tells
        await asyncio.sleep(1)


async def test_what_stands_behind_a_record_is_said_after_the_sync_and_never_if_that_fails() -> None:
    stage = Stage()
    core = ScriptedCore([Persist((b"a", b"b")), Broadcast(NOTICE), Persist((b"c",)), Broadcast(NOTICE)])
    _engine(core, stage).start(stage)  # type: ignore[arg-type]
    assert stage.told == ["append a", "append b", "sync", "broadcast", "append c", "sync", "broadcast"]
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
    await engine.stop()


@in_virtual_time
async def test_when_the_disk_takes_writes_again_the_word_leaves_behind_a_journal_written_anew() -> None:
    """R38: the whole of what the core said is written first, whatever became of the file that failed."""
    stage = Stage()
    stage.refuses = True
    core = ScriptedCore([Persist((b"a",)), Broadcast(NOTICE)], [Broadcast(NOTICE)])
    engine = _engine(core, stage)
    engine.start(stage)  # type: ignore[arg-type]
    for _ in range(3):
        await asyncio.sleep(1)
        assert stage.told == ["append a"]
    stage.refuses = False
    engine.submit(TimerFired(kind="round", round=1, now_ms=1))
    await _until_it_writes(engine)
    assert stage.told == ["append a", "recover ['all that was said']", "broadcast", "broadcast"]
    assert engine.is_signing
    assert [type(event) for event in core.events] == [Started, TimerFired]
    await engine.stop()


@in_virtual_time
async def test_a_node_that_cannot_write_keeps_nothing_that_its_peers_will_say_again() -> None:
    stage = Stage()
    stage.refuses = True
    core = ScriptedCore([Persist((b"a",))])
    engine = _engine(core, stage)
    engine.start(stage)  # type: ignore[arg-type]
    for _ in range(1_000):
        engine.submit(NoticeReceived(notice=NOTICE, now_ms=1))
    assert not engine._events
    stage.refuses = False
    await _until_it_writes(engine)
    engine.submit(NoticeReceived(notice=NOTICE, now_ms=1))
    assert [type(event) for event in core.events] == [Started, NoticeReceived]
    await engine.stop()


@in_virtual_time
async def test_a_full_ledger_disk_stops_the_engine_until_it_is_resumed() -> None:
    stage = Stage()
    core = ScriptedCore([], [Broadcast(NOTICE)])
    engine = _engine(core, stage)
    engine.start(stage)  # type: ignore[arg-type]
    engine.pause("ledger", "The ledger cannot be written.")
    engine.submit(TimerFired(kind="round", round=1, now_ms=1))
    assert (stage.told, engine.fault) == ([], "The ledger cannot be written.")
    engine.resume("ledger")
    assert (stage.told, engine.fault) == (["broadcast"], "")
    await engine.stop()


async def test_on_a_slow_disk_the_loop_goes_on_and_the_order_is_kept() -> None:
    stage = Stage()
    stage.gate = threading.Event()
    core = ScriptedCore([Persist((b"a",)), Broadcast(NOTICE)], [Broadcast(NOTICE)])
    engine = _engine(core, stage)
    engine._journal_writer._sync_ms = 50.0
    engine.start(stage)  # type: ignore[arg-type]
    engine.submit(WorkChanged(pending=True, now_ms=1))
    await asyncio.sleep(0)
    assert stage.told == ["append a"]
    assert len(core.events) == 1
    stage.gate.set()
    await engine.stop_waiting()
    assert stage.told == ["append a", "sync", "broadcast", "broadcast"]
    assert [type(event) for event in core.events] == [Started, WorkChanged]


async def test_work_is_told_only_once_what_was_ordered_is_done() -> None:
    """Between a certificate and the commit that follows, a call that is final would be work: for a block without calls."""
    stage, done = Stage(), iter([True, False])
    engine = _engine(core := ScriptedCore([Broadcast(NOTICE), Broadcast(NOTICE)]), stage)

    def change(_: Any) -> None:
        stage.has_calls = next(done)
        engine.note_work()

    stage.broadcast = change  # type: ignore[method-assign]
    engine.start(stage)  # type: ignore[arg-type]
    assert [type(event) for event in core.events] == [Started]
    stage.has_calls = True
    engine.note_work()
    assert [type(event) for event in core.events] == [Started, WorkChanged]


async def test_a_timer_comes_back_with_its_round_and_a_cancelled_one_does_not() -> None:
    stage = Stage()
    core = ScriptedCore([SetTimer(TIMER_ROUND, 7, 0), SetTimer("other", 8, 0), CancelTimer("other")])
    engine = _engine(core, stage)
    engine.start(stage)  # type: ignore[arg-type]
    for _ in range(5):
        await asyncio.sleep(0)
    assert core.events[1:] == [TimerFired(kind=TIMER_ROUND, round=7, now_ms=1)]


async def test_a_round_that_is_given_up_counts_once_however_often_that_is_said_again() -> None:
    stage = Stage()
    seventh, eighth = (
        Timeout(epoch=0, round=number, index=1, signature=bytes(65), qc=NOTICE.qc, entered_by=None) for number in (7, 8)
    )
    core = ScriptedCore([Broadcast(seventh), Broadcast(seventh), Broadcast(eighth), Broadcast(eighth)])
    engine = _engine(core, stage)
    engine.start(stage)  # type: ignore[arg-type]
    assert stage.told == ["broadcast", "gossip"] * 4
    assert engine.rounds_timed_out_count == 2


async def test_an_action_between_events_waits_for_a_running_sync() -> None:
    stage = Stage()
    stage.gate = threading.Event()
    core = ScriptedCore([Persist((b"a",))])
    engine = _engine(core, stage)
    engine._journal_writer._sync_ms = 50.0
    engine.start(stage)  # type: ignore[arg-type]
    engine.call_between_events(lambda: stage.told.append("action"))
    assert "action" not in stage.told
    stage.gate.set()
    await engine.stop_waiting()
    assert stage.told == ["append a", "sync", "action"]
