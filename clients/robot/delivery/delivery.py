"""Delivers spooled clips to custodians and chain: upload, record, confirm.

One transaction per clip, after up to 0.5 s random delay, so a scene's owners are not adjacent on chain. Steps are
idempotent; after a crash, spooled clips are delivered again.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Literal, Protocol

import msgspec
import structlog

from clients.robot.recording.spool import Delivered, Spool, SpooledClip
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.records.clips import ClipUpload

SUBMIT_DELAY_MAX_MS = 500
DELIVERIES_AT_ONCE_MAX_COUNT = 8
CLIPS_LOADED_MAX_COUNT = 32
"""How many clips are in memory at once, of up to 4 MiB each; the others wait on disk."""

RETRY_FIRST_MS = 200
RETRY_MAX_MS = 5_000
RETRY_TOLD_EVERY_MS = 10_000
OVERDUE_AFTER_MS = 24 * 60 * 60 * 1000
"""The chain takes no record of a day ago (`BUCKET_AGE_MAX_MS` of the contract `records`)."""

_OVERDUE_CODES = frozenset({"BUCKET_WRONG", "EXPIRY_WRONG"})
_NOT_OURS = "NOT_THE_ROBOT"
"""Another robot, which saw the announcement on its way, opened a visit under this key first: a robot that lies."""

_VISIT_EXISTS, _RECORD_EXISTS = "VISIT_EXISTS", "RECORD_EXISTS"
CUSTODIANS_WORD = frozenset({"CLIP_ERASED", "UPLOAD_CONFLICT"})
"""A custodian that lies can say so of any clip."""
_OPEN_VISIT = "open_visit"

Whose = Literal["none", "this", "another"]
"""Whose the visit or record is that the chain proves."""

_log = structlog.get_logger("delivery")


class RecordedBefore(Exception):  # noqa: N818 - no error: there is nothing to do
    """The clip's record was final before a restart, and may have been erased since."""


class ConsentEnded(Exception):  # noqa: N818 - no error: the person's word
    """The clip's person no longer consents."""


async def _nothing(_: SpooledClip) -> None: ...


class DeliveryNetwork(Protocol):
    """What delivery needs of the network, signed as the robot."""

    def sign(self, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        """As the robot."""

    async def submit_and_wait(self, transaction: Transaction) -> Confirmation:
        """Raises network errors."""

    async def upload(self, upload: ClipUpload) -> None:
        """Raises when too few acknowledged."""

    async def robot_of_visit(self, owner: bytes) -> Whose:
        """Raises network errors."""

    async def robot_of_record(self, record_id: bytes) -> Whose:
        """Raises network errors."""

    def now_ms(self) -> int: ...


class Confirmation(Protocol):
    """A final receipt."""

    @property
    def ok(self) -> bool: ...

    @property
    def code(self) -> str:
        """`OK`, or the contract's code."""


class Delivery:
    """Delivers clips from a spool until each is final, several at once."""

    def __init__(
        self,
        spool: Spool,
        network: DeliveryNetwork,
        *,
        on_delivered: Callable[[Delivered], None],
        may_record_clip: Callable[[SpooledClip], Awaitable[bool]],
        on_dropped: Callable[[SpooledClip], Awaitable[None]] = _nothing,
        at_once: bool = False,
    ) -> None:
        """`may_record_clip` is checked before each announcement or record, and after upload. Refused clips are destroyed,
        then `on_dropped` is called.
        """
        self._spool = spool
        self._network = network
        self._on_delivered = on_delivered
        self._may_record = may_record_clip
        self._on_dropped = on_dropped
        self._delay_max_ms = 0 if at_once else SUBMIT_DELAY_MAX_MS
        self._loaded = asyncio.Semaphore(CLIPS_LOADED_MAX_COUNT)
        self._slots = asyncio.Semaphore(DELIVERIES_AT_ONCE_MAX_COUNT)
        self._announcements: dict[bytes, asyncio.Task[None]] = {}
        self._known_visits: set[bytes] = set()
        self._tried_visits: set[bytes] = set()
        self._done_counts: Counter[bytes] = Counter()  # of clips that were not destroyed, by owner key
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._destroying = asyncio.Lock()  # one at a time: threads are wanted for the picture work
        self._finishing: set[asyncio.Task[None]] = set()
        self.failure: BaseException | None = None
        self.dropped_count = 0
        self._retry_told_ms: dict[str, int] = {}

    def start(self, name: str) -> None:
        task = asyncio.create_task(self._deliver(name))
        self._tasks[name] = task
        task.add_done_callback(lambda done: self._finished(name, done))

    def _finished(self, name: str, task: asyncio.Task[None]) -> None:
        self._tasks.pop(name, None)
        if not task.cancelled() and task.exception() is not None:
            self.failure = task.exception()

    def announce(self, clip_or_visit: SpooledClip) -> asyncio.Task[None]:
        owner = clip_or_visit.owner
        if owner not in self._announcements:
            self._announcements[owner] = asyncio.create_task(self._open_visit(clip_or_visit))
        return self._announcements[owner]

    def has_announced(self, owner: bytes) -> bool:
        return owner in self._known_visits

    async def _announced(self, clip: SpooledClip) -> None:
        while True:
            task = self.announce(clip)
            try:
                await asyncio.shield(task)
                return
            except ConsentEnded:
                if self._announcements.get(clip.owner) is task:
                    del self._announcements[clip.owner]
                if not await self._may_record(clip):
                    raise

    async def _open_visit(self, clip: SpooledClip) -> None:
        arguments = [clip.owner, clip.ephemeral, clip.view_tag, clip.visit_bucket_ms, clip.purpose]
        await self._final("records", _OPEN_VISIT, arguments, accepted=("OK", _VISIT_EXISTS), clip=clip)
        self._known_visits.add(clip.owner)

    async def close_visits(self, visits: UnclosedVisitStore) -> None:
        """Close all visits known to the chain and forget all, after delivery of every clip. Visits destroyed before
        announcement are not revealed. If a restart leaves this unknown, a node is asked.
        """
        for owner, record_count in visits.counts.items():
            await self._close(visits, owner, record_count)

    async def close_over(self, visits: UnclosedVisitStore, goes_on: Callable[[bytes], bool]) -> None:
        """Close this run's ended visits whose records are all final; others next time. `goes_on` is checked before the
        record count is read, so the count is complete.
        """
        for owner in visits.counts:
            if owner in visits.inherited or goes_on(owner) or self._done_counts[owner] != visits.counts[owner]:
                continue
            await self._delay()
            try:
                await self._close(visits, owner, visits.counts[owner])
            except BlockRobotError as error:
                _log.warning("visit_not_closed", code=error.code)

    async def _close(self, visits: UnclosedVisitStore, owner: bytes, record_count: int) -> None:
        doubtful = owner in visits.inherited or owner in self._tried_visits
        if self.has_announced(owner) or (doubtful and await self._is_on_chain(owner)):
            await self.close_visit(owner, record_count)
        visits.forget(owner)
        self._known_visits.discard(owner)
        self._tried_visits.discard(owner)
        self._announcements.pop(owner, None)
        del self._done_counts[owner]
        await asyncio.to_thread(visits.save)

    async def _is_on_chain(self, owner: bytes) -> bool:
        wait_ms = RETRY_FIRST_MS
        while True:
            try:
                return await self._network.robot_of_visit(owner) == "this"
            except BlockRobotError as error:
                if not error.entry.retryable:
                    raise
                self._note_retry("visit", error.code)
                await asyncio.sleep(wait_ms / 1000)
                wait_ms = min(2 * wait_ms, RETRY_MAX_MS)

    async def close_visit(self, owner: bytes, record_count: int) -> None:
        """Record a visit's record count, exposing a missing tail."""
        await self._final("records", "close_visit", [owner, record_count], accepted=("OK", "VISIT_CLOSED", _NOT_OURS))

    async def drain(self) -> None:
        """Wait until started clips are final. Raises permanent failures."""
        while self._tasks:
            await asyncio.wait(list(self._tasks.values()))
        if self.failure is not None:
            raise self.failure

    async def stop(self) -> None:
        """Stop without network; clips stay spooled."""
        tasks = [*self._tasks.values(), *self._announcements.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, *self._finishing, return_exceptions=True)

    async def _final(
        self,
        contract: str,
        entry: str,
        arguments: list[Any],
        *,
        accepted: tuple[str, ...],
        clip: SpooledClip | None = None,
        upload: ClipUpload | None = None,
    ) -> tuple[bytes, int]:
        """Upload, then submit until final, across disconnections and expiries; return (txid, submission time). Raises
        NOT_PERMITTED if the contract refuses, ConsentEnded.
        """
        wait_ms = RETRY_FIRST_MS
        while True:
            if clip is not None and not await self._may_record(clip):
                raise ConsentEnded
            transaction = self._network.sign(contract, entry, arguments)
            try:
                if clip is not None and upload is not None:
                    expiry = transaction.body.valid_until_ms
                    await self._upload(
                        clip, msgspec.structs.replace(upload, txid=transaction.txid, valid_until_ms=expiry)
                    )
                    # An upload takes as long as the slowest custodian does.
                    if not await self._may_record(clip):
                        raise ConsentEnded
                if entry == _OPEN_VISIT:
                    self._tried_visits.add(arguments[0])
                submitted = self._network.now_ms()
                confirmation = await self._network.submit_and_wait(transaction)
                if clip is not None:
                    await self._require_own(clip, confirmation.code)
            except BlockRobotError as error:
                if not error.entry.retryable and error.code != "TRANSACTION_EXPIRED":
                    raise
                self._note_retry(entry, error.code)
                await asyncio.sleep(wait_ms / 1000)
                wait_ms = min(2 * wait_ms, RETRY_MAX_MS)
                continue
            if confirmation.code not in accepted:
                detail = f"The chain refused {contract}.{entry}: {confirmation.code}."
                raise _refused(detail, confirmation.code)
            return transaction.txid, submitted

    def _note_retry(self, entry: str, code: str) -> None:
        """Once in a while for each code, however many clips wait for the same."""
        now_ms = self._network.now_ms()
        if now_ms - self._retry_told_ms.get(code, now_ms - RETRY_TOLD_EVERY_MS) >= RETRY_TOLD_EVERY_MS:
            self._retry_told_ms[code] = now_ms
            _log.warning("retry", entry=entry, code=code, clips_waiting=len(self._tasks))

    async def _upload(self, clip: SpooledClip, upload: ClipUpload) -> None:
        """What no upload can mend is believed once the chain proves it. Raises RecordedBefore, NOT_PERMITTED."""
        try:
            await self._network.upload(upload)
        except BlockRobotError as error:
            if error.code not in CUSTODIANS_WORD:
                raise
            robot = await self._network.robot_of_record(upload.record_id)
            if robot == "this":
                raise RecordedBefore from error
            if robot == "another" or self._is_old(clip):
                detail = f"Custodians take {upload.record_id.hex()} no more, or another robot has opened its visit."
                raise _refused(detail, _RECORD_EXISTS) from error
            detail = f"A custodian says {error.code}, of which the chain knows nothing."
            raise BlockRobotError("STORE_UNAVAILABLE", detail) from error

    async def _require_own(self, clip: SpooledClip, code: str) -> None:
        """What exists already must be this robot's: custodians would refuse clips of another's visit again and again.

        Raises NOT_PERMITTED if it is another's, TRANSACTION_EXPIRED if no node proves it yet.
        """
        if code == _VISIT_EXISTS:
            robot = await self._network.robot_of_visit(clip.owner)
        elif code == _RECORD_EXISTS:
            robot = await self._network.robot_of_record(clip.upload.record_id)
        else:
            return
        if robot == "none":
            raise BlockRobotError("TRANSACTION_EXPIRED", "No node proves what there is said to be.")
        if robot == "another":
            raise _refused("Another robot has opened a visit under this owner key.", _NOT_OURS)

    async def _deliver(self, name: str) -> None:
        async with self._loaded:
            await self._deliver_loaded(name, self._spool.get(name))

    async def _deliver_loaded(self, name: str, clip: SpooledClip) -> None:
        try:
            txid, submitted = await self._record(clip)
        except RecordedBefore:
            self._spool.remove(name)
            self._done_counts[clip.owner] += 1
            return
        except BlockRobotError as error:
            if error.context.get("contract_code") not in {_NOT_OURS, _RECORD_EXISTS} and not self._is_overdue(
                clip, error
            ):
                raise
            # No chain will ever take it, and its pictures must not outlive their owner's say: they see a gap.
            _log.error("clip_dropped", bucket_ms=clip.bucket_ms, code=error.context.get("contract_code"))
            self._spool.remove(name)
            self.dropped_count += 1
            self._done_counts[clip.owner] += 1
            return
        except ConsentEnded:
            await self._finish(self._destroy(name, clip))
            return
        self._spool.remove(name)
        self._done_counts[clip.owner] += 1
        self._on_delivered(
            Delivered(clip=clip, txid=txid, submitted_at_ms=submitted, final_at_ms=self._network.now_ms())
        )

    async def _finish(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._finishing.add(task)
        task.add_done_callback(self._finishing.discard)
        await asyncio.shield(task)

    async def _destroy(self, name: str, clip: SpooledClip) -> None:
        """Destroyed before it is reported: a crash between shows it as missing."""
        async with self._destroying:
            await asyncio.to_thread(self._spool.destroy, name)
            await self._on_dropped(clip)

    def _is_overdue(self, clip: SpooledClip, error: BlockRobotError) -> bool:
        return self._is_old(clip) and error.context.get("contract_code") in _OVERDUE_CODES

    def _is_old(self, clip: SpooledClip) -> bool:
        now_ms = self._network.now_ms()
        return min(clip.bucket_ms, clip.visit_bucket_ms) < now_ms - OVERDUE_AFTER_MS or clip.expires_at_ms <= now_ms

    async def _delay(self) -> None:
        if self._delay_max_ms:
            await asyncio.sleep(random.SystemRandom().uniform(0, self._delay_max_ms) / 1000)

    async def _record(self, clip: SpooledClip) -> tuple[bytes, int]:
        await self._announced(clip)
        await self._delay()
        arguments = [
            clip.upload.record_id,
            clip.owner,
            clip.commitment_root,
            clip.ciphertext_root,
            clip.sealed_metadata,
            clip.bucket_ms,
            clip.expires_at_ms,
        ]
        async with self._slots:
            return await self._final(
                "records", "record", arguments, accepted=("OK", _RECORD_EXISTS), clip=clip, upload=clip.upload
            )


def _refused(detail: str, contract_code: str) -> BlockRobotError:
    return BlockRobotError("NOT_PERMITTED", detail, contract_code=contract_code)
