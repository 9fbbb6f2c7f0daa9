"""The robot's own command in a process of its own, that ends itself with SIGKILL at one named step of the pipeline.

`python -m tests.cluster.robot_to_kill STEP DIARY ARGUMENTS...` runs `blockrobot ARGUMENTS...`. The product knows nothing
of it: a step is a call of the product's own functions, wrapped here before the command starts. `DIARY` tells, outside the
robot's folder, what came by: records sealed and spooled, and the secrets that must be on no disk.
"""

from __future__ import annotations

import asyncio
import functools
import inspect
import json
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clients.robot.cli import main as robot_cli
from clients.robot.delivery.delivery import Delivery
from clients.robot.delivery.robot_network import RobotNetwork
from clients.robot.recording import sealing, sensor_recorder, spool, visit_keyring
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.recording.sensor_recorder import SensorRecorder
from clients.robot.recording.spool import Spool
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from clients.robot.run import runner
from clients.sdk import network_client, new_files
from clients.sdk.chain.custody_client import CustodyClient
from clients.sdk.network_client import NetworkClient
from consensus.chain.transaction import Transaction
from network.cli.main import main

NO_STEP = "none"
Call = Callable[[tuple[Any, ...], Any], bool]
"""Whether a call is the step: by its arguments, and its result (None before it)."""


@dataclass(frozen=True, slots=True)
class Step:
    """A step: before or after the nth call of `owner.name` that `counts`.

    `halts`: other calls of it wait for the end. `spoils`: half of the file that is written is cut off first.
    """

    owner: Any
    name: str
    after: bool = False
    counts: Call = lambda _arguments, _result: True
    number: int = 1
    halts: bool = False
    spoils: bool = False


def _calls(entry: str) -> Call:
    """Count transactions that call one entry of the contract `records`."""

    def counts(arguments: tuple[Any, ...], _: Any) -> bool:
        transaction = arguments[1]
        return isinstance(transaction, Transaction) and transaction.body.entry == entry

    return counts


def _path_of(descriptor: int) -> Path:
    return Path(f"/proc/self/fd/{descriptor}").readlink()


def _syncs_clip(arguments: tuple[Any, ...], _: Any) -> bool:
    return _path_of(arguments[0]).name.endswith(".clip")


def _syncs_visits(arguments: tuple[Any, ...], _: Any) -> bool:
    return _path_of(arguments[0]).name.endswith("open-visits")


def _in_spool(arguments: tuple[Any, ...], _: Any) -> bool:
    return bool(arguments[0].name == "spool")


STEPS: dict[str, Step] = {
    # A picture on its way to the spool: lost with the robot's memory, and nowhere else.
    "frame-received": Step(RunStatistics, "frame_arrived", number=3),
    "frame-decided": Step(SensorRecorder, "process", after=True, number=2),
    "clip-filled": Step(SensorRecorder, "seal", number=2),
    "clip-sealed": Step(sensor_recorder, "seal_clip", after=True, number=2),
    "spooled-half": Step(os, "fsync", counts=_syncs_clip, number=2, spoils=True),
    "spooled-before-sync": Step(os, "fsync", counts=_syncs_clip, number=2),
    "spooled-after-sync": Step(os, "fsync", after=True, counts=_syncs_clip, number=2),
    # From here on a clip is never lost, nor is its visit without it.
    "spooled-before-folder-sync": Step(new_files, "sync_folder", counts=_in_spool, number=2),
    "spooled": Step(Spool, "put", after=True, number=2),
    "visit-counted-before-sync": Step(os, "fsync", counts=_syncs_visits, number=2),
    "visit-counted": Step(UnclosedVisitStore, "save", after=True, number=3),
    "announcing": Step(RobotNetwork, "submit_and_wait", counts=_calls("open_visit")),
    "announcement-submitted": Step(NetworkClient, "submit", after=True, counts=_calls("open_visit")),
    "announced": Step(RobotNetwork, "submit_and_wait", after=True, counts=_calls("open_visit")),
    "uploading": Step(CustodyClient, "upload_clip", number=2),
    "uploaded-to-one": Step(CustodyClient, "upload_clip", after=True, halts=True),
    "uploaded-to-all": Step(RobotNetwork, "upload", after=True),
    "record-submitted": Step(NetworkClient, "submit", after=True, counts=_calls("record")),
    "record-submitted-second": Step(NetworkClient, "submit", after=True, counts=_calls("record"), number=2),
    "receipt-seen": Step(RobotNetwork, "submit_and_wait", after=True, counts=_calls("record")),
    "spool-entry-removed": Step(Spool, "remove", after=True, number=2),
    "record-counted": Step(runner, "note_delivered", after=True, number=2),
    "all-delivered": Step(Delivery, "drain", after=True),
    "closing": Step(RobotNetwork, "submit_and_wait", counts=_calls("close_visit")),
    "closing-submitted": Step(NetworkClient, "submit", after=True, counts=_calls("close_visit")),
    "visit-closed": Step(RobotNetwork, "submit_and_wait", after=True, counts=_calls("close_visit")),
    "visit-forgotten": Step(UnclosedVisitStore, "forget", after=True),
    "pin-written": Step(network_client, "replace_file"),
    "summary-told": Step(robot_cli, "print_answer"),
    # What must not be recorded is destroyed.
    "clip-nameless": Step(spool, "_wipe"),
    "clip-destroyed": Step(Spool, "destroy", after=True),
    "visit-lowered": Step(runner, "note_dropped", after=True),
}


class Diary:
    """A file of JSON lines, each there before the next thing happens."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def note(self, what: str, value: Any) -> None:
        """Write one line."""
        os.write(self._descriptor, (json.dumps([what, value]) + "\n").encode())


class Killer:
    """Waits for its step, and kills this process there."""

    def __init__(self, step_name: str, diary: Diary) -> None:
        self._name = step_name
        self._diary = diary
        self._count = 0

    def watch(self, step: Step) -> None:
        """Wrap the function whose call is the step."""
        wrap(step.owner, step.name, self._around(step))

    def _around(self, step: Step) -> Around:
        def here(arguments: tuple[Any, ...], result: Any) -> bool:
            if not step.counts(arguments, result):
                return False
            self._count += 1
            if self._count == step.number:
                if step.spoils:
                    os.ftruncate(arguments[0], os.fstat(arguments[0]).st_size // 2)
                self._diary.note("reached", self._name)
                os.kill(os.getpid(), signal.SIGKILL)
            return True

        before = None if step.after else here
        after = here if step.after else None
        return Around(before=before, after=after, halts=step.halts)


@dataclass(slots=True)
class Around:
    """What is done before and after a call. `halts`: a call that began before the first one ended never begins."""

    before: Call | None = None
    after: Call | None = None
    halts: bool = False
    began: int = 0


def wrap(owner: Any, name: str, around: Around) -> None:
    """Put something around a function of a class or module, plain or asynchronous. It must be there."""
    inner = getattr(owner, name)

    @functools.wraps(inner)
    async def asynchronous(*arguments: Any, **named: Any) -> Any:
        around.began += 1
        if around.halts and around.began > 1:
            await asyncio.Event().wait()
        if around.before is not None:
            around.before(arguments, None)
        result = await inner(*arguments, **named)
        if around.after is not None:
            around.after(arguments, result)
        return result

    @functools.wraps(inner)
    def plain(*arguments: Any, **named: Any) -> Any:
        if around.before is not None:
            around.before(arguments, None)
        result = inner(*arguments, **named)
        if around.after is not None:
            around.after(arguments, result)
        return result

    setattr(owner, name, asynchronous if inspect.iscoroutinefunction(inner) else plain)


def keep_diary(diary: Diary) -> None:
    """Note what is sealed and spooled, and every secret that a sealed clip is made with."""

    def sealed(arguments: tuple[Any, ...], clip: Any) -> bool:
        frames = [[frame.sequence, frame.captured_at_ms] for frame in arguments[0].renditions]
        diary.note("sealed", [clip.upload.record_id.hex(), frames if clip.sensor == "depth" else []])
        for rendition in arguments[0].renditions:
            if len(rendition.pixels) > 128:
                diary.note("secret", rendition.pixels[64:96].hex())
        return True

    def spooled(arguments: tuple[Any, ...], _: Any) -> bool:
        diary.note("spooled", arguments[1].upload.record_id.hex())
        return True

    def secret(place: int) -> Call:
        def note(arguments: tuple[Any, ...], _: Any) -> bool:
            diary.note("secret", arguments[place].hex())
            return True

        return note

    wrap(sensor_recorder, "seal_clip", Around(after=sealed))
    wrap(Spool, "put", Around(after=spooled))
    wrap(sealing, "seal_data_key", Around(before=secret(1)))
    wrap(visit_keyring, "open_visit_keys", Around(before=secret(0)))


if __name__ == "__main__":
    own_diary = Diary(Path(sys.argv[2]))
    keep_diary(own_diary)
    if sys.argv[1] != NO_STEP:
        Killer(sys.argv[1], own_diary).watch(STEPS[sys.argv[1]])
    main(args=sys.argv[3:], prog_name="blockrobot")
