"""Give, refuse, withdraw and read consent. Statements are signed with the member key (a representative's own) and kept
under the person's handle.
"""

from __future__ import annotations

from dataclasses import dataclass

from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.kept_proofs import keep_receipt
from consensus.limits import TIME_BUCKET_MS
from consensus.rights.purposes import require_published
from consensus.rights.sensors import SENSORS, require_sensor
from consensus.state.consent import CHOICES, GIVEN, StepRow, effective_consent, read_choices

DEPTH = "depth"
"""By this sensor a robot tells people apart: without a yes to it, nothing of any other is kept."""


@dataclass(frozen=True, slots=True)
class ConsentDecision:
    """A final statement: transaction, block, effective height. `count` is the choices changed; 0 may still cancel a
    pending earlier consent.
    """

    txid: bytes
    height: int
    from_height: int
    count: int


@dataclass(frozen=True, slots=True)
class Choice:
    """One purpose and sensor: last statement, and whether consent holds now."""

    purpose: str
    sensor: str
    holds: bool
    last: StepRow


@dataclass(frozen=True, slots=True)
class Choices:
    """All choices of a person, proven as of one block."""

    height: int
    time_ms: int
    rows: tuple[Choice, ...]

    def stands(self, row: Choice) -> bool:
        """Whether the last statement is a yes, in its period, even if effective only from the next block."""
        last = row.last
        return last.status == GIVEN and last.from_ms <= self.time_ms and not 0 < last.until_ms <= self.time_ms

    @property
    def lacking_depth(self) -> list[Choice]:
        """Each yes without effect, lacking depth for its purpose."""
        standing = [row for row in self.rows if self.stands(row)]
        seen = {row.purpose for row in standing if row.sensor == DEPTH}
        return [row for row in standing if row.purpose not in seen]


def round_period(from_ms: int, until_ms: int) -> tuple[int, int]:
    """Shrink to full five minutes: exact times would identify it on chain."""
    return -(-from_ms // TIME_BUCKET_MS) * TIME_BUCKET_MS, until_ms - until_ms % TIME_BUCKET_MS


class ConsentClient:
    """Consents of the wallet's owner, or of `represented` (a handle) by mandate."""

    def __init__(self, wallet: Wallet, represented: bytes | None = None) -> None:
        self._wallet = wallet
        self._represented = represented

    @property
    def _handle(self) -> bytes:
        return self._represented or self._wallet.store.content.handle

    async def give(
        self,
        purposes: list[str],
        sensors: list[str],
        *,
        from_ms: int = 0,
        until_ms: int = 0,
        height: int = 0,
        seen_height: int | None = None,
    ) -> ConsentDecision:
        """Consent within a period (0: unbounded) from a height (0: next block).

        Signs over `seen_height`, which proved the notice shown (default: newest proved block), against delayed
        delivery. Raises VALUE_INVALID, NOT_REGISTERED, CALL_REFUSED (WORD_OLDER).
        """
        self.require_known(purposes, sensors)
        await self._wallet.require_registered()
        seen = seen_height
        if seen is None:
            seen = (await self._wallet.network.newest_header(self._wallet.keys.identity)).height
        period = round_period(from_ms, until_ms)
        return await self._say("give", "given", purposes, sensors, *period, height, seen)

    async def refuse(self, purposes: list[str], sensors: list[str]) -> ConsentDecision:
        """No sensors: all. Raises as `give`."""
        return await self._say("refuse", "refused", purposes, sensors)

    async def withdraw(self, purposes: list[str], sensors: list[str]) -> ConsentDecision:
        """No sensors: all. Raises as `give`."""
        return await self._say("withdraw", "withdrawn", purposes, sensors)

    async def _say(
        self, entry: str, event: str, purposes: list[str], sensors: list[str], *more: int
    ) -> ConsentDecision:
        self.require_known(purposes, sensors)
        await self._wallet.require_registered()
        receipt = await self._wallet.network.call(
            self._wallet.keys.identity, "consent", entry, [self._handle, purposes, sensors, *more]
        )
        if self._represented is None:  # an export tells of kept receipts as of own words
            keep_receipt(self._wallet.store.content, receipt)
        (data,) = receipt.event_data("consent", event)
        count = data.get("count", len(purposes) * len(sensors or SENSORS))
        return ConsentDecision(txid=receipt.txid, height=receipt.height, from_height=data["height"], count=count)

    def require_known(self, purposes: list[str], sensors: list[str]) -> None:
        """Raise PURPOSE_UNKNOWN, SENSOR_UNKNOWN."""
        require_published(purposes, self._wallet.genesis.purposes)
        for code in sensors:
            require_sensor(code)

    async def choices(self) -> Choices:
        """Proven. Raises NOT_REGISTERED, PROOF_*."""
        await self._wallet.require_registered()
        place = CHOICES.key(self._handle)
        state = await self._wallet.network.state_values([place], self._wallet.keys.identity)
        rows = [
            _choice(purpose, sensor, steps, state.height, state.timestamp_ms)
            for (purpose, sensor), steps in sorted(read_choices(state.values[place]).items())
        ]
        return Choices(height=state.height, time_ms=state.timestamp_ms, rows=tuple(rows))


def _choice(purpose: str, sensor: str, steps: tuple[StepRow, ...], height: int, time_ms: int) -> Choice:
    consent = effective_consent(steps, height)
    holds = consent is not None and consent.from_ms <= time_ms and not 0 < consent.until_ms <= time_ms
    return Choice(purpose, sensor, holds, steps[-1])
