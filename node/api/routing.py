"""Routes as data: path, access, limits, documents; source of application and reference."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import msgspec
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from consensus.api_documents import Document
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import EXACT_INTEGER_END
from node.api.access.metering import Meter, Readings, Steps
from node.api.access.request_rate_limiter import ChargedBudgets
from node.api.access.route_access import Access
from node.api.access.sessions import Session, SessionTable, read_token
from node.api.bodies import Hold
from node.api.ports import ApiServices
from node.limits.token_buckets import Source
from node.storage.ledger_view import LedgerView
from pages.listening import NO_KEY, Connection, awaiting_body

JSON = "application/json"
MSGPACK = "application/msgpack"
BYTES = "application/octet-stream"
SSE = "text/event-stream"
BODY_DEFAULT_MAX_BYTES = 64 * 1024
BODY_TIMEOUT_MS = 60_000

D = TypeVar("D", bound=Document)
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A path or query parameter: `size_bytes` of hex, `pattern` text, or an integer."""

    name: str
    place: str
    description: str
    size_bytes: int | None = None
    minimum: int = 0
    maximum: int = EXACT_INTEGER_END - 1
    default: int | None = None
    pattern: str | None = None

    @property
    def required(self) -> bool:
        return self.place == "path" or (self.default is None and self.pattern is None)


@dataclass(frozen=True, slots=True)
class Body:
    """A request's body: a JSON document type, or bytes with a media type."""

    media_type: str
    kind: type[Document] | None
    description: str
    max_bytes: int = BODY_DEFAULT_MAX_BYTES


@dataclass(frozen=True, slots=True)
class Answer:
    """What a request gets on success."""

    media_type: str
    kind: type[Document] | None
    description: str
    status: int = 200


@dataclass(slots=True)
class Call:
    """One authorised request, as handlers see it."""

    services: ApiServices
    sessions: SessionTable
    http: web.Request
    route: Route
    session: Session | None
    tab: ChargedBudgets
    hold: Hold
    meter: Meter
    readings: Readings

    @property
    def source(self) -> Source:
        return self.tab.source

    async def read(self, work: Callable[[LedgerView], Steps[T]]) -> T:
        """Run work on the newest finalized snapshot, in slices off the event loop.

        Raises RATE_LIMITED in debt, and as the work.
        """
        return await self.readings.read(self.source, self.meter, work)

    def is_allowed_still(self) -> bool:
        """For an answer that goes on: whether its session still lets it."""
        try:
            token = read_token(self.http)
            self.route.access.check(None if token is None else self.sessions.resolve(token))
        except BlockRobotError:
            return False
        return True

    @property
    def caller(self) -> bytes:
        """Return the session's proven key (routes with a session only)."""
        if self.session is None:
            raise BlockRobotError("SESSION_REQUIRED")
        return self.session.public_key

    def bytes_of(self, name: str) -> bytes:
        """Return a hexadecimal parameter. Raises REQUEST_INVALID."""
        parameter = self._parameter(name)
        text = self._text(parameter)
        size = parameter.size_bytes or 0
        if text is None or len(text) != 2 * size or not set(text) <= set("0123456789abcdef"):
            raise BlockRobotError("REQUEST_INVALID", f"The parameter {name} is {size} bytes in lower-case hexadecimal.")
        return bytes.fromhex(text)

    def int_of(self, name: str) -> int:
        """Return an integer parameter, or its default. Raises REQUEST_INVALID."""
        parameter = self._parameter(name)
        text = self._text(parameter)
        if text is None and parameter.default is not None:
            return parameter.default
        if text is None or not (text.isascii() and text.isdigit() and len(text) <= 16):
            raise BlockRobotError("REQUEST_INVALID", f"The parameter {name} is a whole number.")
        number = int(text)
        if not parameter.minimum <= number <= parameter.maximum:
            raise BlockRobotError(
                "REQUEST_INVALID", f"The parameter {name} lies between {parameter.minimum} and {parameter.maximum}."
            )
        return number

    @property
    def body_size_bytes(self) -> int:
        """Return the body's declared size, else the limit. Raises REQUEST_TOO_LARGE."""
        limit = self.route.body.max_bytes if self.route.body else 0
        stated = self.http.content_length
        if stated is not None and stated > limit:
            raise BlockRobotError("REQUEST_TOO_LARGE", f"The body may have at most {limit} bytes.")
        return limit if stated is None else stated

    async def body(self) -> bytes:
        """Raises MEDIA_TYPE_UNSUPPORTED, REQUEST_TOO_LARGE, REQUEST_TIMEOUT, REQUEST_INVALID, RATE_LIMITED."""
        self._require_media_type()
        limit, content = self.body_size_bytes, bytearray()
        try:
            with awaiting_body(self.http):
                async with asyncio.timeout(BODY_TIMEOUT_MS / 1000):
                    async for chunk in self.http.content.iter_chunked(64 * 1024):
                        self.hold(len(chunk))
                        content += chunk
                        if len(content) > limit:
                            raise BlockRobotError("REQUEST_TOO_LARGE", f"The body may have at most {limit} bytes.")
        except TimeoutError:
            raise BlockRobotError("REQUEST_TIMEOUT") from None
        except (web.RequestPayloadError, HttpProcessingError):
            raise BlockRobotError("REQUEST_INVALID", "The body's framing is damaged.") from None
        return bytes(content)

    @contextmanager
    def hold_back(self) -> Iterator[bool]:
        """Delay the answer within the context; yields False if too many wait."""
        connection = self.http.protocol
        if not isinstance(connection, Connection):
            yield True
            return
        key = NO_KEY if self.session is None else self.session.public_key
        with connection.hold_back(key, str(self.source)) as allowed:
            yield allowed

    def _require_media_type(self) -> None:
        if "Content-Encoding" in self.http.headers:
            raise BlockRobotError("MEDIA_TYPE_UNSUPPORTED", "The route takes no packed bodies.")
        if self.route.body and self.http.content_type not in {self.route.body.media_type, BYTES}:
            raise BlockRobotError("MEDIA_TYPE_UNSUPPORTED", f"The route takes {self.route.body.media_type}.")

    async def document(self, kind: type[D]) -> D:
        """Raises REQUEST_INVALID, REQUEST_TOO_LARGE."""
        content = await self.body()
        try:
            return read_json_as(content, kind)
        except TextInvalidError as error:
            raise BlockRobotError("REQUEST_INVALID", f"The body is no {kind.__name__}: {error}.") from None

    def _parameter(self, name: str) -> Parameter:
        return next(parameter for parameter in self.route.parameters if parameter.name == name)

    def _text(self, parameter: Parameter) -> str | None:
        if parameter.place == "path":
            return self.http.match_info[parameter.name]
        return self.http.query.get(parameter.name)


Handler = Callable[[Call], Awaitable[web.StreamResponse]]


@dataclass(frozen=True, slots=True)
class Route:
    """A method of a path; `errors` lists codes beyond every route's."""

    method: str
    path: str
    operation: str
    summary: str
    access: Access
    handler: Handler
    answer: Answer
    body: Body | None = None
    parameters: tuple[Parameter, ...] = ()
    errors: tuple[str, ...] = ()


def json_answer(document: Document, status: int = 200) -> web.Response:
    return web.Response(
        body=msgspec.json.encode(document), status=status, content_type=JSON, headers={"Cache-Control": "no-store"}
    )


def bytes_answer(content: bytes, media_type: str) -> web.Response:
    return web.Response(body=content, content_type=media_type, headers={"Cache-Control": "no-store"})
