"""What this node said in its last rounds: whether it proposed, voted, gave up. Must never change or hold back a word.

It stands right before the peers, so that of a node that lies on purpose it notes what really went out.
"""

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
    """The last rounds in which this node said anything, oldest first. On the event loop only."""

    def __init__(self, clock: Callable[[], int], leader: Callable[[int, int], str | None]) -> None:
        """`clock` says ms since 1970; `leader` names who leads a round of an epoch, None if that is not known."""
        self._clock = clock
        self._leader = leader
        self._rounds: OrderedDict[tuple[int, int], tuple[str | None, dict[str, int]]] = OrderedDict()

    def note(self, epoch: int, round_number: int, word: str) -> None:
        """Note one word; one that is said again counts as when it was first said."""
        place = (epoch, round_number)
        known = self._rounds.get(place)
        if known is None:
            known = self._rounds[place] = (self._leader(epoch, round_number), {})
            if len(self._rounds) > ROUNDS_KEPT_COUNT:
                self._rounds.popitem(last=False)
        known[1].setdefault(word, self._clock())

    def describe(self) -> list[dict[str, Any]]:
        """Return the rounds, ready for JSON: epoch, round, its leader, and when which word was said (ms since 1970)."""
        return [
            {"epoch": epoch, "round": number, "leader": leader, "said": words}
            for (epoch, number), (leader, words) in self._rounds.items()
        ]


class LoggingOutbox:
    """An outbox that notes votes, timeouts and proposals on their way out."""

    def __init__(self, inner: Outbox, spoken: RoundLog) -> None:
        self._inner = inner
        self._spoken = spoken

    def broadcast(self, message: Message) -> None:
        """Send to all peers."""
        self._note(message)
        if isinstance(message, Proposal):
            header = message.block.header
            self._spoken.note(header.epoch, header.round, PROPOSED)
        self._inner.broadcast(message)

    def send_to(self, index: int, message: Message) -> None:
        """Send to one producer. A proposal may be another leader's, passed on to who lacks it."""
        self._note(message)
        self._inner.send_to(index, message)

    def fetch(self, effect: FetchBlocks) -> None:
        """Ask producers for blocks."""
        self._inner.fetch(effect)

    def gossip_again(self) -> None:
        """Send the waiting transactions to all peers again."""
        self._inner.gossip_again()

    def _note(self, message: Message) -> None:
        match message:
            case Vote(epoch=epoch, round=number):
                self._spoken.note(epoch, number, VOTED)
            case Timeout(epoch=epoch, round=number):
                self._spoken.note(epoch, number, GAVE_UP)
