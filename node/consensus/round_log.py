"""Logs what this node really sent in its last rounds."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from consensus.chain.messages import Proposal, Timeout, Vote
from consensus.protocol.effects import FetchBlocks, Message
from node.consensus.engine import Outbox

ROUNDS_KEPT_COUNT = 32
PROPOSED, VOTED, GAVE_UP = "proposed", "voted", "gave-up"


class RoundLog:
    """The last rounds with messages, oldest first. Event loop only."""

    def __init__(self, clock: Callable[[], int], leader: Callable[[int, int], str | None]) -> None:
        """`clock`: ms since 1970; `leader`: a round's leader, or None."""
        self._clock = clock
        self._leader = leader
        self._rounds: OrderedDict[tuple[int, int], tuple[str | None, dict[str, int]]] = OrderedDict()

    def note(self, epoch: int, round_number: int, kind: str) -> None:
        place = (epoch, round_number)
        known = self._rounds.get(place)
        if known is None:
            known = self._rounds[place] = (self._leader(epoch, round_number), {})
            if len(self._rounds) > ROUNDS_KEPT_COUNT:
                self._rounds.popitem(last=False)
        known[1].setdefault(kind, self._clock())

    def describe(self) -> list[dict[str, Any]]:
        """JSON-ready; times in ms since 1970."""
        return [
            {"epoch": epoch, "round": number, "leader": leader, "messages": kinds}
            for (epoch, number), (leader, kinds) in self._rounds.items()
        ]


class LoggingOutbox:
    """An outbox that logs votes, timeouts and proposals."""

    def __init__(self, inner: Outbox, spoken: RoundLog) -> None:
        self._inner = inner
        self._spoken = spoken

    def broadcast(self, message: Message) -> None:
        self._note(message)
        if isinstance(message, Proposal):
            header = message.block.header
            self._spoken.note(header.epoch, header.round, PROPOSED)
        self._inner.broadcast(message)

    def send_to(self, index: int, message: Message) -> None:
        self._note(message)
        self._inner.send_to(index, message)

    def fetch(self, effect: FetchBlocks) -> None:
        self._inner.fetch(effect)

    def gossip_again(self) -> None:
        self._inner.gossip_again()

    def _note(self, message: Message) -> None:
        match message:
            case Vote(epoch=epoch, round=number):
                self._spoken.note(epoch, number, VOTED)
            case Timeout(epoch=epoch, round=number):
                self._spoken.note(epoch, number, GAVE_UP)
