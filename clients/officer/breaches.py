"""Officers' breaches: read, assess, notify, close; signed and audited, 72 hours by chain time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from clients.officer.lost_keys import active_records
from clients.officer.officer_answers import BreachAnswer, BreachAssessed, BreachClosed, BreachNotice, BreachNotices
from clients.sdk.chain.proved_rows import proved_list, proved_row, proved_rows
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.terminal.json_answers import convert_row
from clients.wallet.ledger.id_prefix import BREACH, resolve_id_prefix
from clients.wallet.ledger.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.limits import RECORDS_A_CALL_MAX_COUNT
from consensus.rights.right_codes import Correction, commit_correction
from consensus.state import rights
from consensus.state.rights import BreachRow, CorrectionRow

OnProgress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Breach:
    """One denied visit, proven at block time `now_ms`; `state` is the contract's row."""

    breach_id: bytes
    state: BreachRow
    now_ms: int

    @property
    def is_open(self) -> bool:
        return self.state.status != "closed"

    @property
    def left_ms(self) -> int:
        """Remaining ms of 72 hours, negative when over."""
        return self.state.due_ms - self.now_ms

    @property
    def is_overdue(self) -> bool:
        waits = self.state.risk != "none" and "authority" not in self.state.notified
        return self.is_open and waits and self.left_ms < 0


class Breaches:
    """A network's breaches for one officer."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet
        self._key = wallet.keys.identity
        self._read = wallet.reading(self._key)

    async def read_all(self) -> list[Breach]:
        """Oldest first. Raises SESSION_REFUSED."""
        ids = await proved_list(self._read, rights.BREACH_COUNT, rights.BREACH_NUMBER)
        rows = await proved_rows(self._read, rights.BREACH, ids)
        now_ms = (await self._wallet.network.newest_header(self._key)).timestamp_ms
        return [Breach(breach_id, row, now_ms) for breach_id, row in zip(ids, rows, strict=True)]

    async def find(self, start: str) -> Breach:
        """By id prefix. Raises BREACH_NOT_FOUND, NAME_TOO_SHORT, NAME_AMBIGUOUS."""
        known = await self.read_all()
        return known[resolve_id_prefix(BREACH, [breach.breach_id.hex() for breach in known], start)]

    async def assess(self, breach: Breach, risk: str, reason: str) -> FinalReceipt:
        """Raises CALL_REFUSED with the contract's code."""
        return await self._call("assess", [breach.breach_id, risk, reason])

    async def notify(self, breach: Breach, recipient: str, reason: str) -> FinalReceipt:
        """Raises CALL_REFUSED with the contract's code."""
        return await self._call("notify", [breach.breach_id, recipient, reason])

    async def close(self, breach: Breach, outcome: str, reason: str, on_progress: OnProgress) -> int:
        """Return how many erasures were ordered; `erased` erases all records after notices. Raises CALL_REFUSED."""
        ids: list[bytes] = []
        if outcome == "erased":
            breach = await self.find(breach.breach_id.hex())
            require_notified(breach)
            ids = await active_records(self._wallet, breach.state.owner)
        for start in range(0, len(ids), RECORDS_A_CALL_MAX_COUNT):
            on_progress(start, len(ids))
            await self._call("order_erasure", [breach.breach_id, ids[start : start + RECORDS_A_CALL_MAX_COUNT]])
        if breach.is_open or not ids:
            await self._call("close", [breach.breach_id, outcome, reason])
        return len(ids)

    async def get_correction(self, correction: Correction) -> tuple[int, CorrectionRow]:
        """Its number and proven row. Raises CORRECTION_UNPROVEN."""
        owner = bytes.fromhex(correction.visit)
        count = await proved_row(self._read, rights.CORRECTION_COUNT, owner) or 0
        values = await self._read(rights.correction_keys(owner, count))
        commitment = commit_correction(correction)
        for number, key in enumerate(rights.correction_keys(owner, count)):
            row = rights.CORRECTION.convert(values[key])
            if (row.commitment, row.kind) == (commitment, correction.kind):
                return number, row
        raise BlockRobotError("CORRECTION_UNPROVEN")

    async def _call(self, entry: str, arguments: list[Any]) -> FinalReceipt:
        return await self._wallet.network.call(self._key, "rights", entry, arguments)


def require_notified(breach: Breach) -> None:
    """Raise CALL_REFUSED unless assessed and required notices given."""
    state = breach.state
    if state.assessed is None:
        raise BlockRobotError("CALL_REFUSED", "BREACH_NOT_ASSESSED: The breach is assessed first.")
    if state.risk != "none" and "authority" not in state.notified:
        raise BlockRobotError(
            "CALL_REFUSED", "BREACH_NOT_NOTIFIED: Where there is a risk, the authority is told before."
        )
    if state.risk == "high" and "subjects" not in state.notified:
        raise BlockRobotError("CALL_REFUSED", "BREACH_NOT_NOTIFIED: Where it is high, the subjects are told before.")


def breach_answer(breach: Breach) -> BreachAnswer:
    state = breach.state
    return BreachAnswer(
        breach_id=breach.breach_id.hex(),
        kind=state.kind,
        organisation=state.org,
        robot=state.robot.hex(),
        visit=state.owner.hex(),
        status=state.status,
        risk=state.risk or None,
        opened_ms=state.opened_ms,
        due_ms=state.due_ms,
        left_ms=breach.left_ms,
        overdue=breach.is_overdue,
        assessed=None if state.assessed is None else convert_row(state.assessed, BreachAssessed),
        notified=BreachNotices(**{who: convert_row(step, BreachNotice) for who, step in state.notified.items()}),
        closed=None if state.closed is None else convert_row(state.closed, BreachClosed),
    )
