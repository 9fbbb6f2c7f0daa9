"""Blobs as objects of an S3 bucket, by aiobotocore (the extra `s3`). What its server answers is not trusted."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from configparser import Error as ConfigError
from configparser import RawConfigParser
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any, Self

import aiohttp
import structlog
from aiobotocore.awsrequest import AioAWSResponse
from aiobotocore.config import AioConfig
from aiobotocore.httpsession import AIOHTTPSession
from aiobotocore.session import get_session
from botocore.exceptions import ClientError, HTTPClientError
from botocore.handlers import add_expect_header

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace, invalid_place

log = structlog.get_logger(__name__)

CONNECT_MAX_S, ANSWER_MAX_S = 3.0, 10.0
CALL_MAX_S = 120.0
"""With a clip's content, and tried again; also for all pages of one clip's names."""
LISTING_MAX_S = 3_600.0
"""Waiting for all pages of the bucket's names."""
TRIES_MAX_COUNT = 3
CONNECTIONS_MAX_COUNT = 16
ANSWER_MAX_BYTES = 2 << 20
"""Of all but a blob: a page has up to 1,000 keys of up to 1,024 bytes, and some 350 bytes more for each."""
PAGES_OF_A_CLIP_MAX_COUNT = 100
"""A clip has one blob, and rarely a few. How many the bucket has nobody can say: of its pages only none comes twice."""
CREDENTIALS_MAX_BYTES = 1 << 16
USER_AGENT = "blockrobot"
_KEYS = ("aws_access_key_id", "aws_secret_access_key", "aws_session_token")
_CODE = re.compile(r"[A-Za-z0-9.]{1,64}")
_GONE = frozenset({"NoSuchKey", "404", "NotFound"})
_NOT_THERE = frozenset({"ObjectLockConfigurationNotFoundError", "NotImplemented", "MethodNotAllowed", "501", "405"})
_HINTS = {
    "NoSuchBucket": "The bucket is not there.",
    "AccessDenied": "These credentials may not do that.",
    "InvalidAccessKeyId": "The server does not know these credentials.",
    "SignatureDoesNotMatch": "The secret key is wrong.",
    "RequestTimeTooSkewed": "The clocks of this machine and of the server differ.",
}


class _BoundedSession(AIOHTTPSession):  # type: ignore[misc]
    """Follows no redirect, and reads no answer without an end, both of which the library would do."""

    async def _get_session(self, proxy_url: str | None) -> Any:
        session = await super()._get_session(proxy_url)
        return SimpleNamespace(request=partial(session.request, allow_redirects=False))

    async def send(self, request: Any) -> Any:
        is_blob, request.stream_output = request.stream_output, True  # so that it is not read yet
        answer = await super().send(request)
        if is_blob and answer.status_code < 300:
            return answer
        try:
            content = await _read_bounded(answer.raw.content, ANSWER_MAX_BYTES)
        except (aiohttp.ClientError, TimeoutError) as error:
            raise HTTPClientError(error=error) from error
        finally:
            answer.raw.release()
        if content is None:
            raise _wrong_answer("it is too long")
        return AioAWSResponse(answer.url, answer.status_code, answer.headers, _Content(content))


class _Content:
    """As the library takes it: a body that is read already."""

    def __init__(self, content: bytes) -> None:
        self._content = content

    async def read(self) -> bytes:
        return self._content


async def _read_bounded(stream: Any, max_bytes: int) -> bytes | None:
    """None for more; `read` gives what has arrived."""
    content = bytearray()
    while part := await stream.read(max_bytes + 1 - len(content)):
        content += part
        if len(content) > max_bytes:
            return None
    return bytes(content)


class S3Blobs:
    """A `BlobStore` in one bucket, below a prefix."""

    def __init__(self, place: ClipsPlace) -> None:
        self._place = place
        self._stack = AsyncExitStack()
        self._client: Any = None

    async def __aenter__(self) -> Self:
        """Raises STORE_UNAVAILABLE, and CONFIGURATION_INVALID for a bucket from which nothing can be deleted."""
        place = self._place
        keys = {} if place.credentials_path is None else read_keys(place.credentials_path)
        config = AioConfig(
            connect_timeout=CONNECT_MAX_S,
            read_timeout=ANSWER_MAX_S,
            max_pool_connections=CONNECTIONS_MAX_COUNT,
            retries={"mode": "standard", "total_max_attempts": TRIES_MAX_COUNT},
            s3={"addressing_style": "path"},
            request_checksum_calculation="when_required",
            response_checksum_validation="when_required",
            # The library's check of what it is given, and the list of this machine's versions that it makes for each
            # request, take a fifth of a call's CPU time. The versions are nothing for the server.
            parameter_validation=False,
            user_agent=USER_AGENT,
            http_session_cls=_BoundedSession,
        )
        async with _asking():
            session = get_session()
            session.user_agent_extra = ""
            # Times are not used here; to read them takes most of a page of names, while the event loop stands still.
            session.get_component("response_parser_factory").set_parser_defaults(timestamp_parser=str)
            client = session.create_client(
                "s3",
                region_name=place.region,
                endpoint_url=place.endpoint or None,
                verify=None if place.ca_path is None else str(place.ca_path),
                config=config,
                **keys,
            )
            self._client = await self._stack.enter_async_context(client)
            # A clip is small: to wait for `100 Continue` before it is sent costs more than to send it in vain.
            self._client.meta.events.unregister("before-call.s3", add_expect_header)
        try:
            await self._require_erasable()
        except BaseException:
            await self._stack.aclose()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._stack.aclose()

    async def _require_erasable(self) -> None:
        bucket = self._place.bucket
        async with _asking():
            await self._client.head_bucket(Bucket=bucket)
        lock = await self._asked("get_object_lock_configuration")
        if lock.get("ObjectLockConfiguration", {}).get("ObjectLockEnabled") == "Enabled":
            detail = f"The bucket {bucket} has Object Lock: what is erased would stay in it. Give a bucket without."
            raise BlockRobotError("CONFIGURATION_INVALID", detail)
        if (await self._asked("get_bucket_versioning")).get("Status") == "Enabled":
            log.warning("clips_versioned", bucket=bucket, detail="Erased clips' ciphertexts stay as older versions.")

    async def _asked(self, operation: str) -> dict[str, Any]:
        """Empty where the server does not know the question."""
        async with _asking():
            try:
                answer: dict[str, Any] = await getattr(self._client, operation)(Bucket=self._place.bucket)
            except ClientError as error:
                if _code(error) in _NOT_THERE:
                    return {}
                raise
        return answer

    async def put(self, name: str, content: bytes) -> None:
        async with _asking():
            await self._client.put_object(Bucket=self._place.bucket, Key=self._place.prefix + name, Body=content)

    async def get(self, name: str, max_bytes: int) -> bytes | None:
        async with _asking():
            try:
                answer = await self._client.get_object(Bucket=self._place.bucket, Key=self._place.prefix + name)
            except ClientError as error:
                if _code(error) in _GONE:
                    return None
                raise
            async with answer["Body"] as body:
                if answer["ContentLength"] > max_bytes:  # without one, half an answer would look whole
                    return None
                return await _read_bounded(body, max_bytes)

    async def delete(self, name: str) -> None:
        async with _asking():
            await self._client.delete_object(Bucket=self._place.bucket, Key=self._place.prefix + name)

    async def has(self, name: str) -> bool:
        async with _asking():
            try:
                await self._client.head_object(Bucket=self._place.bucket, Key=self._place.prefix + name)
            except ClientError as error:
                if _code(error) in _GONE:
                    return False
                raise
        return True

    async def names(self, prefix: str = "") -> AsyncIterator[str]:
        own, clock = self._place.prefix, asyncio.get_running_loop().time
        asked: dict[str, str] = {"Bucket": self._place.bucket, "Prefix": own + prefix}
        left_s = CALL_MAX_S if prefix else LISTING_MAX_S
        marked, pages_count = "", 0
        while True:
            since = clock()
            async with _asking(min(CALL_MAX_S, left_s)):
                page = await self._client.list_objects_v2(**asked)
                keys = [found["Key"] for found in page.get("Contents", ())]
                if not all(key.startswith(own + prefix) for key in keys):
                    raise _wrong_answer("it lists keys that were not asked for")
                asked["ContinuationToken"] = page["NextContinuationToken"] if page.get("IsTruncated") else ""
            left_s -= clock() - since
            for key in keys:
                yield key.removeprefix(own)
            token, pages_count = asked["ContinuationToken"], pages_count + 1
            if not token:
                return
            if token == marked:
                raise _wrong_answer("its list of keys has no end")
            if prefix and pages_count >= PAGES_OF_A_CLIP_MAX_COUNT:
                raise _wrong_answer("its list of one clip's keys has no end")
            if pages_count & (pages_count - 1) == 0:  # marked anew at each power of two, it meets itself in any circle
                marked = token

    async def clear_unfinished(self) -> None:
        """An object is there whole or not at all."""


def read_keys(path: Path) -> dict[str, str]:
    """The keys under [default], and nothing else: the library's own reader would run a program that the file names.

    Raises CONFIGURATION_INVALID, without what the file says.
    """
    parser = RawConfigParser(default_section="")
    try:
        with path.open("rb") as file:
            parser.read_string(file.read(CREDENTIALS_MAX_BYTES).decode())
        found = {key: parser.get("default", key, fallback="") for key in _KEYS}
    except OSError as error:
        raise invalid_place(f"clips_credentials {path} cannot be read: {error.strerror}.") from None
    except (ConfigError, UnicodeDecodeError):
        found = {}
    if not all(found.get(key) for key in _KEYS[:2]):
        raise invalid_place(f"{path} needs {_KEYS[0]} and {_KEYS[1]} under [default]; nothing else in it counts.")
    return {key: value for key, value in found.items() if value}


def _code(error: ClientError) -> str:
    code = str(error.response.get("Error", {}).get("Code", ""))
    return code if _CODE.fullmatch(code) else ""


def _wrong_answer(why: str) -> BlockRobotError:
    return BlockRobotError("STORE_UNAVAILABLE", f"The S3 server does not answer as it should ({why}).")


@asynccontextmanager
async def _asking(max_s: float | None = None) -> AsyncIterator[None]:
    """End what takes too long, and turn failures into STORE_UNAVAILABLE, without what they quote of the request."""
    try:
        async with asyncio.timeout(CALL_MAX_S if max_s is None else max_s):
            yield
    except BlockRobotError:
        raise
    except ClientError as error:
        code = _code(error)
        detail = f"The S3 server refuses with {code or 'an error'}. {_HINTS.get(code, '')}".strip()
        raise BlockRobotError("STORE_UNAVAILABLE", detail) from error
    except Exception as error:  # whatever the library makes of an answer of the wrong form
        raise _wrong_answer(type(error).__name__) from error
