"""RFID readers over LLRP, in one thread; unencrypted: use the robot's own network."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import os
import threading
import time
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from typing import Any

import click

from clients.robot.sensing.sensor_events import NS_PER_MS, RefusedMessage, Sighting
from clients.robot.sources.live.live_feed import CLOSE_MAX_S, Feed, Listener
from clients.robot.sources.live.llrp_readings import GATHER_MS, LlrpReadings
from clients.robot.sources.messages.topics import LLRP_PORT, LlrpReader, load_topics
from consensus.errors import BlockRobotError
from consensus.visible_text import printable

OPEN_MAX_S = 5.0
ANSWER_MAX_S = 3.0
LEAVE_MAX_S = 2.0
ASK_EVERY_S = 3.0
"""How often a reader is asked whether it is there: with no tag in range it has nothing to say."""

TRY_AGAIN_FIRST_S, TRY_AGAIN_MAX_S = 0.5, 15.0
FIRST_TRIES_COUNT = 3
"""A reader serves one at a time, and may not have noticed yet that the one before is gone."""

STEADY_AFTER_S = 10.0
"""After a connection that held so long the first pause is short again."""

DRAIN_MAX_COUNT = 256
SAID_MAX_CHARS = 160
ROSPEC_ID = 0x4252
SESSION = 0
"""Of the four sessions of Gen2 the one in which a tag answers in every round, so that one sees that it is still there."""


def parse_address(text: str) -> LlrpReader:
    """Parse HOST, HOST:PORT or [IPV6]:PORT. Raises BadParameter."""
    host, mark, port = text.rpartition("]:" if "[" in text else ":")
    if not mark:
        host, port = text, str(LLRP_PORT)
    host = host.strip("[]")
    if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) <= 65_535:
        raise click.BadParameter(f"{text[:64]!r} is no address of a reader: HOST or HOST:PORT.")
    return LlrpReader(host, int(port))


def _parse_addresses(_context: click.Context, _parameter: click.Parameter, texts: Sequence[str]) -> list[LlrpReader]:
    return [parse_address(text) for text in texts]


OPTIONS = (
    click.option(
        "--llrp",
        "llrp_readers",
        multiple=True,
        callback=_parse_addresses,
        metavar="HOST[:PORT]",
        help="Ask this RFID reader for tags, by LLRP; may be given again. [default: those of the topics file]",
    ),
)


def make_feeds(options: Mapping[str, Any]) -> Sequence[Feed]:
    """Of option or topics-file readers. Raises TOPICS_INVALID."""
    known = load_topics(options.get("topics_file")).llrp
    tables = {reader.address: reader for reader in known}
    named = dict.fromkeys(options.get("llrp_readers") or ())
    readers = [tables.get(reader.address, reader) for reader in named] or list(known)
    return [LlrpFeed(readers)] if readers else []


class LlrpFeed:
    """Several readers; lost ones are retried with backoff until `close`."""

    name = "llrp"
    ros1 = False

    def __init__(self, readers: Sequence[LlrpReader]) -> None:
        self._readers = tuple(readers)
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._work: asyncio.Task[None] | None = None

    def topics(self) -> dict[str, str]:
        return {}

    def open(self, wanted: Mapping[str, str], listener: Listener) -> None:  # noqa: ARG002 - a reader has no topics
        """Raises FEED_UNREACHABLE, MIDDLEWARE_MISSING."""
        library = _Library()
        opening = _Opening(len(self._readers))
        links = [_Link(library, reader, listener, opening) for reader in self._readers]
        self._thread = threading.Thread(target=self._run, args=(links, opening, listener), name="llrp", daemon=True)
        self._thread.start()
        error = opening.wait()
        if error is not None:
            self.close()
            raise error

    def close(self) -> None:
        if self._loop is not None and self._work is not None:
            with contextlib.suppress(RuntimeError):  # it has ended by itself
                self._loop.call_soon_threadsafe(self._work.cancel)
        if self._thread is not None:
            self._thread.join(CLOSE_MAX_S)

    def _run(self, links: Sequence[_Link], opening: _Opening, listener: Listener) -> None:
        try:
            asyncio.run(self._serve(links))
        except asyncio.CancelledError:
            return
        except Exception as error:  # noqa: BLE001 - nobody else would hear of it in this thread
            lost = BlockRobotError("FEED_LOST", f"The readers cannot be asked any more: {type(error).__name__}.")
            opening.failed(lost)
            listener.fail(lost)

    async def _serve(self, links: Sequence[_Link]) -> None:
        self._loop, self._work = asyncio.get_running_loop(), asyncio.current_task()
        # What a reader's nonsense breaks in the library ends that connection, with our own message.
        self._loop.set_exception_handler(lambda _loop, _context: None)
        async with asyncio.TaskGroup() as group:
            for link in links:
                group.create_task(link.serve())


class _Opening:
    def __init__(self, count: int) -> None:
        self._left = count
        self._error: BlockRobotError | None = None
        self._done = threading.Event()

    def succeeded(self) -> None:
        self._left -= 1
        if self._left == 0:
            self._done.set()

    def failed(self, error: BlockRobotError) -> None:
        self._error = self._error or error
        self._done.set()

    def wait(self) -> BlockRobotError | None:
        if not self._done.wait(FIRST_TRIES_COUNT * (OPEN_MAX_S + LEAVE_MAX_S)):
            return BlockRobotError("FEED_UNREACHABLE", "The LLRP readers do not answer.")
        return self._error


class _Link:
    def __init__(self, library: _Library, reader: LlrpReader, listener: Listener, opening: _Opening) -> None:
        self._library = library
        self._reader = reader
        self._listener = listener
        self._opening = opening
        self._readings = LlrpReadings(reader)

    async def serve(self) -> None:
        """Serve until cancelled; give up only if the first connect fails."""
        pause_s, has_opened, tries_left = TRY_AGAIN_FIRST_S, False, FIRST_TRIES_COUNT
        loop = asyncio.get_running_loop()
        while True:
            began_s, is_here, why = loop.time(), False, ""
            try:
                async with self._joined() as link:
                    is_here = True
                    if has_opened:
                        self._listener.presence(self._reader.address, here=True)
                    else:
                        self._opening.succeeded()
                    has_opened = True
                    await self._read(link)
            except Exception as error:  # noqa: BLE001 - whatever a reader sends, the other readers and the run go on
                why = _why(error)
            tries_left -= 1
            if not has_opened and not tries_left:
                self._opening.failed(_unreachable(self._reader, why))
                return
            self._tell(self._readings.flush())
            if is_here:
                self._listener.presence(self._reader.address, here=False)
            pause_s = TRY_AGAIN_FIRST_S if loop.time() - began_s >= STEADY_AFTER_S else pause_s
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, TRY_AGAIN_MAX_S)

    @contextlib.asynccontextmanager
    async def _joined(self) -> AsyncIterator[Any]:
        link = self._library.connect_to(self._reader)
        try:
            async with asyncio.timeout(OPEN_MAX_S):
                await link.connect()
                await self._library.start(link)
            yield link
        finally:
            with contextlib.suppress(Exception):
                async with asyncio.timeout(LEAVE_MAX_S):
                    await self._library.stop(link)
            with contextlib.suppress(Exception):
                async with asyncio.timeout(LEAVE_MAX_S):
                    await link.close()

    async def _read(self, link: Any) -> None:
        loop = asyncio.get_running_loop()
        asking = asyncio.create_task(self._ask(link))
        lost, due_s = 0, loop.time() + GATHER_MS / 1000
        try:
            while link.client.connected and not asking.done():
                for report in await _waiting(link.client.reports, max(0.0, due_s - loop.time())):
                    self._take(report)
                if loop.time() >= due_s:
                    self._tell(self._readings.flush())
                    due_s = loop.time() + GATHER_MS / 1000
                if link.client.dropped_reports > lost:
                    self._listener.miss(self._reader.address, link.client.dropped_reports - lost)
                    lost = link.client.dropped_reports
        finally:
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)

    async def _ask(self, link: Any) -> None:
        while True:
            await asyncio.sleep(ASK_EVERY_S)
            await self._library.ask(link)

    def _take(self, report: Any) -> None:
        received_ms = time.time_ns() // NS_PER_MS
        for one in report.tag_report_datas:
            try:
                self._tell(self._readings.convert_report(one, received_ms))
            except Exception:  # noqa: BLE001 - one report that makes no sense is no reason to lose the others
                self._listener.refuse(RefusedMessage(received_ms, "sighting", "undecodable"))

    def _tell(self, made: Iterable[Sighting | RefusedMessage]) -> None:
        for one in made:
            if isinstance(one, RefusedMessage):
                self._listener.refuse(one)
            else:
                self._listener.sight(one)


class _Library:
    """Raises MIDDLEWARE_MISSING."""

    def __init__(self) -> None:
        try:
            self._reader = importlib.import_module("llrpkit.reader").Reader
        except ImportError:
            raise BlockRobotError(
                "MIDDLEWARE_MISSING",
                "Asking LLRP readers needs the package llrpkit: `make install-llrp` in your clone.",
            ) from None
        self._check: Any = importlib.import_module("llrpkit.client").check_status
        self._rospec: Any = importlib.import_module("llrpkit.inventory").build_rospec
        self._messages: Any = importlib.import_module("llrpkit.protocol.messages")
        self._identification = importlib.import_module(
            "llrpkit.protocol.enums"
        ).GetReaderConfigRequestedData.Identification
        logging.getLogger("llrpkit").addHandler(logging.NullHandler())  # it would speak on the user's terminal

    def connect_to(self, reader: LlrpReader) -> Any:
        return self._reader(
            reader.host,
            reader.port,
            response_timeout=ANSWER_MAX_S,
            connect_timeout=OPEN_MAX_S,
            enable_impinj_extensions=False,
        )

    async def start(self, link: Any) -> None:
        job = self._rospec(ro_spec_id=ROSPEC_ID, session=SESSION)
        await link.client.transact(self._messages.DELETE_ROSPEC(ro_spec_id=ROSPEC_ID))  # one of a run that was killed
        for request in (
            self._messages.ADD_ROSPEC(ro_spec=job),
            self._messages.ENABLE_ROSPEC(ro_spec_id=ROSPEC_ID),
            self._messages.START_ROSPEC(ro_spec_id=ROSPEC_ID),
        ):
            self._check(await link.client.transact(request))

    async def stop(self, link: Any) -> None:
        if link.client.connected:
            await link.client.transact(self._messages.STOP_ROSPEC(ro_spec_id=ROSPEC_ID))
            await link.client.transact(self._messages.DELETE_ROSPEC(ro_spec_id=ROSPEC_ID))

    async def ask(self, link: Any) -> None:
        await link.get_config(self._identification)


async def _waiting(reports: asyncio.Queue[Any], wait_s: float) -> list[Any]:
    try:
        async with asyncio.timeout(wait_s):
            found = [await reports.get()]
    except TimeoutError:
        return []
    while len(found) < DRAIN_MAX_COUNT and not reports.empty():
        found.append(reports.get_nowait())
    return found


def _why(error: BaseException) -> str:
    root = error
    while root.__cause__ is not None and not isinstance(root, OSError):
        root = root.__cause__
    if isinstance(root, TimeoutError):
        return f"nothing that speaks LLRP was heard within {OPEN_MAX_S:g} s; is a reader there?"
    if isinstance(root, OSError) and root.errno:
        return os.strerror(root.errno) if root.errno > 0 else "there is no machine of this name"
    return str(error) or type(error).__name__


def _unreachable(reader: LlrpReader, why: str) -> BlockRobotError:
    detail = printable(why, SAID_MAX_CHARS).rstrip(". ")
    return BlockRobotError("FEED_UNREACHABLE", f"The LLRP reader at {reader.address} does not answer: {detail}.")
