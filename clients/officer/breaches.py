"""What data protection officers do of denied visits: read, assess, notify, close.

An officer is a member like others, with a wallet of her own; what she does is signed with her member key and stands in
the audit of the visit. The clock of 72 hours is the chain's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from clients.officer.lost_keys import active_records
from clients.officer.officer_answers import BreachAnswer, BreachAssessed, BreachClosed, BreachNotice, BreachNotices
from clients.sdk.chain.proved_rows import proved_list, proved_row, proved_rows
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.terminal.json_answers import convert_row
from clients.wallet.ledger.id_prefix import BREACH, find_named
from clients.wallet.ledger.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.rights.right_codes import Correction, commit_correction
from consensus.state import rights
from consensus.state.rights import BreachRow, CorrectionRow

RECORDS_A_CALL_MAX_COUNT = 64
Tell = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Breach:
    """One denied visit, proven as of a block whose time is `now_ms`. `state` is the contract's row."""

    breach_id: bytes
    state: BreachRow
    now_ms: int

    @property
    def is_open(self) -> bool:
        """Whether an officer still has something to do."""
        return self.state.status != "closed"

    @property
    def left_ms(self) -> int:
        """How much is left of the 72 hours by the chain's clock; negative once they are over."""
        return self.state.due_ms - self.now_ms

    @property
    def is_overdue(self) -> bool:
        """Whether the authority should have been told, and was not."""
        waits = self.state.risk != "none" and "authority" not in self.state.notified
        return self.is_open and waits and self.left_ms < 0


class Breaches:
    """The breaches of a network, as one officer reads and handles them."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet
        self._key = wallet.keys.identity
        self._read = wallet.reading(self._key)

    async def read_all(self) -> list[Breach]:
        """Return all breaches in the order in which they were opened. Raises SESSION_REFUSED for who is no member."""
        ids = await proved_list(self._read, rights.BREACH_COUNT, rights.BREACH_NUMBER)
        rows = await proved_rows(self._read, rights.BREACH, ids)
        now_ms = (await self._wallet.network.newest_header(self._key)).timestamp_ms
        return [Breach(breach_id, row, now_ms) for breach_id, row in zip(ids, rows, strict=True)]

    async def find(self, start: str) -> Breach:
        """Return the breach whose id (hexadecimal) begins so. Raises BREACH_NOT_FOUND, NAME_TOO_SHORT, NAME_AMBIGUOUS."""
        known = await self.read_all()
        return known[find_named(BREACH, [breach.breach_id.hex() for breach in known], start)]

    async def assess(self, breach: Breach, risk: str, reason: str) -> FinalReceipt:
        """Say how much risk there is, and why. Raises CALL_REFUSED with the contract's code."""
        return await self._call("assess", [breach.breach_id, risk, reason])

    async def notify(self, breach: Breach, recipient: str, reason: str) -> FinalReceipt:
        """Say that the authority or the subjects were told. Raises CALL_REFUSED with the contract's code."""
        return await self._call("notify", [breach.breach_id, recipient, reason])

    async def close(self, breach: Breach, outcome: str, reason: str, tell: Tell) -> int:
        """End a breach; where it ends as `erased`, have every record erased before. Returns how many were ordered.

        Nothing is erased of a breach that could not be closed then: who has to be told is told before. Of one that ended
        as `erased` already, what came to the visit since is erased. Raises CALL_REFUSED with the
        contract's code.
        """
        ids: list[bytes] = []
        if outcome == "erased":
            breach = await self.find(breach.breach_id.hex())
            require_told(breach)
            ids = await active_records(self._wallet, breach.state.owner)
        for start in range(0, len(ids), RECORDS_A_CALL_MAX_COUNT):
            tell(start, len(ids))
            await self._call("order_erasure", [breach.breach_id, ids[start : start + RECORDS_A_CALL_MAX_COUNT]])
        if breach.is_open or not ids:
            await self._call("close", [breach.breach_id, outcome, reason])
        return len(ids)

    async def find_correction(self, correction: Correction) -> tuple[int, CorrectionRow]:
        """Return what the chain holds of a correction that was handed over, proven, and its number.

        Raises CORRECTION_UNPROVEN.
        """
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


def require_told(breach: Breach) -> None:
    """Raise CALL_REFUSED, as the contract would on closing, unless a breach was assessed and whom it concerns was told."""
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
