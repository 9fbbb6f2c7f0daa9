"""Client sessions, one per node, key and grant."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import msgspec
from msgspec import UNSET

from clients.sdk.chain.transactions import Clock
from clients.sdk.connections import REQUEST_TIMEOUT_MS, Connections, NodeAddress
from clients.sdk.node_answers import may_ask_another, read_answer, read_hex
from consensus.api_documents import ChallengeAnswer, ChallengeRequest, Request, SessionAnswer, SessionRequest
from consensus.chain.session_message import CHALLENGE_SIZE_BYTES, sign_session
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

RENEW_BEFORE_MS = 15_000
TOKENS_MAX_COUNT = 1024


@dataclass(frozen=True, slots=True)
class _Token:
    text: str
    kind: str
    expires_at_ms: int


class GrantKey(PrivateKey):
    """A grant's one-time key, with the grant's id (32 bytes): several grants may share a key."""

    __slots__ = ("grant_id",)

    def __init__(self, key: PrivateKey, grant_id: bytes) -> None:
        super().__init__(key.secret)
        self.grant_id = grant_id


def _place(node: NodeAddress, key: PrivateKey) -> tuple[str, bytes, bytes]:
    return (node.name, key.public_key, key.grant_id if isinstance(key, GrantKey) else b"")


class Sessions:
    """Opens sessions on demand and renews them."""

    def __init__(self, chain_id: bytes, connections: Connections, clock: Clock) -> None:
        self._chain_id = chain_id
        self._connections = connections
        self._clock = clock
        self._tokens: OrderedDict[tuple[str, bytes, bytes], _Token] = OrderedDict()

    async def token(self, node: NodeAddress, key: PrivateKey, timeout_ms: int = REQUEST_TIMEOUT_MS) -> str:
        """Opens a session if needed. Raises SESSION_REFUSED, NODE_UNREACHABLE etc.: after each another node may be asked.

        What else who answers there says of a session, as another node at that address does, is NODE_ADDRESS_WRONG.
        """
        place = _place(node, key)
        known = self._tokens.get(place)
        if known is not None and known.expires_at_ms > self._clock.now_ms() + RENEW_BEFORE_MS:
            return known.text
        try:
            opened = await self._open(node, key, timeout_ms)
        except BlockRobotError as error:
            if may_ask_another(error):
                raise
            sentence = f"Who answers at {node.url} opens no session as node {node.name} ({error.code}: {error.detail})"
            raise BlockRobotError("NODE_ADDRESS_WRONG", sentence) from None
        self._tokens[place] = opened
        while len(self._tokens) > TOKENS_MAX_COUNT:
            self._tokens.popitem(last=False)
        return opened.text

    def open_token(self, node: NodeAddress, public_key: bytes) -> str | None:
        """Of this node, grants excluded."""
        known = self._tokens.get((node.name, public_key, b""))
        return known.text if known is not None and known.expires_at_ms > self._clock.now_ms() else None

    def forget(self, node: NodeAddress, key: PrivateKey, token: str) -> None:
        """Drop a rejected token, unless renewed meanwhile."""
        place = _place(node, key)
        known = self._tokens.get(place)
        if known is not None and known.text == token:
            del self._tokens[place]

    def forget_key(self, public_key: bytes) -> None:
        for place in [place for place in self._tokens if place[1] == public_key]:
            del self._tokens[place]

    async def _open(self, node: NodeAddress, key: PrivateKey, timeout_ms: int) -> _Token:
        request = ChallengeRequest(key.public_key.hex())
        content = await self._post(node, key, "/v1/session-challenges", request, timeout_ms)
        challenge = read_hex(read_answer(content, ChallengeAnswer).challenge)
        if len(challenge) != CHALLENGE_SIZE_BYTES:
            raise BlockRobotError("INTERNAL", f"Node {node.name} sent a challenge of a wrong size.")
        signed = SessionRequest(
            public_key=key.public_key.hex(),
            challenge=challenge.hex(),
            signature=sign_session(key, self._chain_id, node.name, challenge).hex(),
            grant=key.grant_id.hex() if isinstance(key, GrantKey) else UNSET,
        )
        answer = read_answer(await self._post(node, key, "/v1/sessions", signed, timeout_ms), SessionAnswer)
        return _Token(text=answer.token, kind=answer.kind, expires_at_ms=answer.expires_at_ms)

    async def _post(self, node: NodeAddress, key: PrivateKey, path: str, request: Request, timeout_ms: int) -> bytes:
        body, lane = msgspec.json.encode(request), key.public_key
        return await self._connections.request(node, "POST", path, lane=lane, body=body, timeout_ms=timeout_ms)
