"""Links between simulated nodes, and their faults."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from dataclasses import dataclass

from consensus.errors import BlockRobotError
from network.sim.world.cpu import COSTS, charge
from network.sim.world.virtual_time import Owner, SimLoop
from node.limits.peer_bans import PeerBans
from node.p2p.connection import REQUESTS_SERVED_MAX_COUNT
from node.p2p.network import REQUEST_TIMEOUT_MS, PeerHandler
from node.p2p.wire import FrameKind, RequestKind, encode_frame

REDIAL_MS = 50.0
STORM_FRAMES_A_LINK_AND_S_MAX_COUNT = 2_000
ANSWER_REFUSED = None
KIB = 1024


@dataclass(slots=True)
class LinkQuality:
    """How frames travel: delays in ms; shares (0 to 1) lost, duplicated or delayed."""

    delay_min_ms: float = 0.5
    delay_max_ms: float = 5.0
    loss: float = 0.0
    duplicates: float = 0.0
    stragglers: float = 0.0
    straggler_ms: float = 300.0


GOOD = LinkQuality()


class Wires:
    """All links; after a `storm` (endless mutual answers) nothing is carried."""

    def __init__(
        self,
        loop: SimLoop,
        dice: random.Random,
        on_frame: Callable[[str, str, int, bytes], None],
        on_cut_off: Callable[[str, str, str], None],
    ) -> None:
        self.loop = loop
        self.dice = dice
        self.quality = GOOD
        self.cut: set[tuple[str, str]] = set()
        self.ends: dict[str, SimNetwork] = {}
        self.frames_count = 0
        self.storm_at_ms: float | None = None
        self._second = -1
        self._second_count = 0
        self._on_frame = on_frame
        self.on_cut_off = on_cut_off

    def transmit(self, sender: str, receiver: str, deliver: Callable[[], None]) -> None:
        """Deliver something with the links' loss, duplication and delay, as the receiver."""
        if (sender, receiver) in self.cut:
            return
        quality, dice = self.quality, self.dice
        copies = 1
        if quality.loss and dice.random() < quality.loss:
            copies = 0
        elif quality.duplicates and dice.random() < quality.duplicates:
            copies = 2
        leaves_s = max(self.loop.time(), self.loop.owner.free_at_s)  # once what it came of is done
        for _ in range(copies):
            delay_ms = dice.uniform(quality.delay_min_ms, quality.delay_max_ms)
            if quality.stragglers and dice.random() < quality.stragglers:
                delay_ms += dice.uniform(0, quality.straggler_ms)
            self.loop.call_for(self.loop.stage, leaves_s + delay_ms / 1000, deliver)

    def carry(
        self,
        source: SimNetwork,
        target_name: str,
        kind: FrameKind,
        payload: bytes,
        then: Callable[[], None] | None = None,
    ) -> None:
        """Carry a frame to a peer if its connection stands on arrival."""
        life = source.lives.get(target_name)
        if life is None or (then is None and self._is_storm()):  # a flood's own frames are no storm
            return
        self.frames_count += 1

        def deliver() -> None:
            target = self.ends.get(target_name)
            if target is None or target.owner is not life or not life.alive:
                return
            if target.lives.get(source.name) is not source.owner:
                return
            self._on_frame(source.name, target_name, kind, payload)
            self.loop.call_soon_for(life, target.receive, source.name, kind, payload)
            if then is not None:
                self.loop.call_soon_for(life, then)

        self.transmit(source.name, target_name, deliver)

    def ask(
        self,
        source: SimNetwork,
        target_name: str,
        number: int,
        kind: RequestKind,
        body: bytes,
        then: Callable[[], None] | None = None,
    ) -> None:
        """Carry a request to a peer that still lives on arrival; `then` follows its answer."""
        life = source.lives.get(target_name)

        def deliver() -> None:
            target = self.ends.get(target_name)
            if target is not None and target.owner is life and life is not None:
                self.loop.call_soon_for(life, target.serve, source, number, kind, body, then)

        self.transmit(source.name, target_name, deliver)

    def _is_storm(self) -> bool:
        second = int(self.loop.time())
        if second != self._second:
            self._second, self._second_count = second, 0
        self._second_count += 1
        links_count = len(self.ends) * (len(self.ends) - 1)
        if self.storm_at_ms is None and self._second_count > STORM_FRAMES_A_LINK_AND_S_MAX_COUNT * max(1, links_count):
            self.storm_at_ms = self.loop.now_ms
        return self.storm_at_ms is not None

    # Connections

    def attach(self, end: SimNetwork) -> None:
        self.ends[end.name] = end
        for name in list(self.ends):
            if name != end.name:
                self._dial(end.name, name)

    def detach(self, name: str) -> None:
        gone = self.ends.pop(name, None)
        if gone is None:
            return
        for peer in list(self.ends.values()):
            if peer.lives.get(name) is gone.owner:
                delay_ms = self.dice.uniform(0.5, 20)
                self.loop.call_for(peer.owner, self.loop.time() + delay_ms / 1000, peer.lose, name, gone.owner)

    def reconnect_all(self) -> None:
        names = sorted(self.ends)
        for number, first in enumerate(names):
            for second in names[number + 1 :]:
                self.break_connection(first, second)

    def break_connection(self, first: str, second: str) -> None:
        for name, peer in ((first, second), (second, first)):
            end = self.ends.get(name)
            if end is not None and end.lives.pop(peer, None) is not None:
                self.loop.call_soon_for(end.owner, end.note_lost, peer)
        self._dial(first, second)

    def _dial(self, first: str, second: str, not_before_ms: float = 0.0) -> None:
        delay_ms = max(0.0, not_before_ms - self.loop.now_ms) + REDIAL_MS * self.dice.uniform(0.5, 1.0)
        self.loop.call_for(self.loop.stage, self.loop.time() + delay_ms / 1000, self._greet, first, second)

    def _greet(self, first: str, second: str) -> None:
        one, other = self.ends.get(first), self.ends.get(second)
        if one is None or other is None or one.lives.get(second) is other.owner:
            return
        if (first, second) in self.cut or (second, first) in self.cut:
            self._dial(first, second)
            return
        not_before_ms = max(one.unheard_until_ms(second), other.unheard_until_ms(first))
        if not_before_ms > self.loop.now_ms:
            self._dial(first, second, not_before_ms)
            return
        for end, peer in ((one, other), (other, one)):
            end.lives[peer.name] = peer.owner
            height = peer.handler.finalized_height()
            self.loop.call_soon_for(end.owner, end.greet, peer.name, peer.owner, height)


class SimNetwork:
    """One node's links during one of its lives (see `node.peers.peers.Network`)."""

    def __init__(self, wires: Wires, owner: Owner, name: str, handler: PeerHandler) -> None:
        self.wires = wires
        self.owner = owner
        self.name = name
        self.handler = handler
        self.lives: dict[str, Owner] = {}
        self.before_send: Callable[[], None] = _nothing
        self._peer_bans = PeerBans(lambda: int(wires.loop.now_ms))
        self._greeted: set[str] = set()
        self._serving: dict[str, int] = {}
        self._requests: dict[int, asyncio.Future[bytes]] = {}
        self._next_request = 0

    @property
    def connected(self) -> list[str]:
        return sorted(self._greeted)

    async def start(self) -> None:
        self.wires.attach(self)

    async def stop(self) -> None:
        self.wires.detach(self.name)

    def broadcast(self, kind: FrameKind, payload: bytes) -> None:
        for peer in sorted(self._greeted):
            self.send(peer, kind, payload)

    def send(self, peer: str, kind: FrameKind, payload: bytes) -> bool:
        if peer not in self._greeted or not self.owner.alive:
            return False
        encode_frame(kind, payload)  # the size limit of the kind holds here too
        self.before_send()
        charge(COSTS.frame + COSTS.kib * len(payload) / KIB)
        self.wires.carry(self, peer, kind, payload)
        return True

    async def request(self, peer: str, kind: RequestKind, body: bytes, timeout_ms: int = REQUEST_TIMEOUT_MS) -> bytes:
        """Raises PEER_UNAVAILABLE if absent, refusing or late."""
        if peer not in self._greeted:
            raise BlockRobotError("PEER_UNAVAILABLE", f"{peer} is not connected.")
        self._next_request = number = self._next_request + 1
        future: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self._requests[number] = future
        self.wires.ask(self, peer, number, kind, body)
        try:
            async with asyncio.timeout(timeout_ms / 1000):
                return await future
        except TimeoutError:
            raise BlockRobotError("PEER_UNAVAILABLE", f"{peer} did not answer in time.") from None
        finally:
            self._requests.pop(number, None)

    # What the wires bring

    def greet(self, peer: str, life: Owner, height: int) -> None:
        if self.lives.get(peer) is life:
            self._greeted.add(peer)
            self.handler.peer_connected(peer, height)

    def lose(self, peer: str, life: Owner) -> None:
        if self.lives.get(peer) is life:
            del self.lives[peer]
            self.note_lost(peer)

    def note_lost(self, peer: str) -> None:
        if peer in self._greeted:
            self._greeted.discard(peer)
            self.handler.peer_disconnected(peer)

    def cut_off(self, peer: str, error: BlockRobotError) -> None:
        if peer in self._greeted:
            self._peer_bans.ban(peer, error)
            self.wires.on_cut_off(self.name, peer, error.code)
            self.wires.break_connection(self.name, peer)

    def unheard_until_ms(self, peer: str) -> int:
        """0: never cut off."""
        return self._peer_bans.until_ms(peer)

    def receive(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        if peer not in self._greeted:
            return
        charge(COSTS.frame + COSTS.kib * len(payload) / KIB)
        try:
            self.handler.peer_frame(peer, kind, payload)
        except BlockRobotError as error:
            self.cut_off(peer, error)

    def serve(
        self, source: SimNetwork, number: int, kind: RequestKind, body: bytes, then: Callable[[], None] | None = None
    ) -> None:
        async def answer() -> None:
            charge(COSTS.request)
            serving = self._serving[source.name] = self._serving.get(source.name, 0) + 1
            try:
                if serving > REQUESTS_SERVED_MAX_COUNT:
                    raise BlockRobotError("PEER_UNAVAILABLE")
                found = await self.handler.peer_request(source.name, kind, body)
                charge(COSTS.kib * len(found) / KIB)
                data: bytes | None = found
            except BlockRobotError:
                data = ANSWER_REFUSED
            finally:
                self._serving[source.name] -= 1
            self.wires.transmit(self.name, source.name, lambda: self._return(source, number, data))
            if then is not None:
                then()

        self.wires.loop.create_task(answer())

    def _return(self, source: SimNetwork, number: int, data: bytes | None) -> None:
        self.wires.loop.call_soon_for(source.owner, source.take_answer, number, data)

    def take_answer(self, number: int, data: bytes | None) -> None:
        future = self._requests.get(number)
        if future is None or future.done():
            return
        if data is ANSWER_REFUSED:
            future.set_exception(BlockRobotError("PEER_UNAVAILABLE", "The peer refused."))
        else:
            future.set_result(data)


def _nothing() -> None:
    """Do nothing: no power cut is armed."""
