"""Blobs as objects of an S3 bucket, by aiobotocore (the extra `s3`)."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, contextmanager
from types import TracebackType
from typing import Any, Self

import aiohttp
import structlog
from aiobotocore.config import AioConfig
from aiobotocore.session import get_session
from botocore.exceptions import BotoCoreError, ClientError

from consensus.errors import BlockRobotError
from node.clips_place import ClipsPlace

log = structlog.get_logger(__name__)

CONNECT_MAX_S, ANSWER_MAX_S = 3.0, 10.0
TRIES_MAX_COUNT = 3
CONNECTIONS_MAX_COUNT = 16
_GONE = frozenset({"NoSuchKey", "404", "NotFound"})
_NOT_THERE = frozenset({"ObjectLockConfigurationNotFoundError", "NotImplemented", "MethodNotAllowed", "501", "405"})
_HINTS = {
    "NoSuchBucket": "The bucket is not there.",
    "AccessDenied": "These credentials may not do that.",
    "InvalidAccessKeyId": "The server does not know these credentials.",
    "SignatureDoesNotMatch": "The secret key is wrong.",
    "RequestTimeTooSkewed": "The clocks of this machine and of the server differ.",
}


class S3Blobs:
    """A `BlobStore` in one bucket, below a prefix."""

    def __init__(self, place: ClipsPlace) -> None:
        self._place = place
        self._stack = AsyncExitStack()
        self._client: Any = None

    async def __aenter__(self) -> Self:
        """Raises STORE_UNAVAILABLE, and CONFIGURATION_INVALID for a bucket from which nothing can be deleted."""
        place, session = self._place, get_session()
        if place.credentials_path is not None:
            session.set_config_variable("credentials_file", str(place.credentials_path))
        config = AioConfig(
            connect_timeout=CONNECT_MAX_S,
            read_timeout=ANSWER_MAX_S,
            max_pool_connections=CONNECTIONS_MAX_COUNT,
            retries={"mode": "standard", "total_max_attempts": TRIES_MAX_COUNT},
            s3={"addressing_style": "path"},
            request_checksum_calculation="when_required",
            response_checksum_validation="when_required",
        )
        with _told():
            client = session.create_client(
                "s3",
                region_name=place.region,
                endpoint_url=place.endpoint or None,
                verify=None if place.ca_path is None else str(place.ca_path),
                config=config,
            )
            self._client = await self._stack.enter_async_context(client)
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
        with _told():
            await self._client.head_bucket(Bucket=bucket)
        lock = await self._asked("get_object_lock_configuration")
        if lock.get("ObjectLockConfiguration", {}).get("ObjectLockEnabled") == "Enabled":
            detail = f"The bucket {bucket} has Object Lock: what is erased would stay in it. Give a bucket without."
            raise BlockRobotError("CONFIGURATION_INVALID", detail)
        if (await self._asked("get_bucket_versioning")).get("Status") == "Enabled":
            log.warning("clips_versioned", bucket=bucket, detail="Erased clips' ciphertexts stay as older versions.")

    async def _asked(self, operation: str) -> dict[str, Any]:
        """Empty where the server does not know the question."""
        with _told():
            try:
                answer: dict[str, Any] = await getattr(self._client, operation)(Bucket=self._place.bucket)
            except ClientError as error:
                if _code(error) in _NOT_THERE:
                    return {}
                raise
        return answer

    async def put(self, name: str, content: bytes) -> None:
        with _told():
            await self._client.put_object(Bucket=self._place.bucket, Key=self._place.prefix + name, Body=content)

    async def get(self, name: str, max_bytes: int) -> bytes | None:
        with _told():
            try:
                answer = await self._client.get_object(Bucket=self._place.bucket, Key=self._place.prefix + name)
            except ClientError as error:
                if _code(error) in _GONE:
                    return None
                raise
            async with answer["Body"] as body:
                if answer["ContentLength"] > max_bytes:
                    return None
                content: bytes = await body.read()
        return content

    async def delete(self, name: str) -> None:
        with _told():
            await self._client.delete_object(Bucket=self._place.bucket, Key=self._place.prefix + name)

    async def has(self, name: str) -> bool:
        with _told():
            try:
                await self._client.head_object(Bucket=self._place.bucket, Key=self._place.prefix + name)
            except ClientError as error:
                if _code(error) in _GONE:
                    return False
                raise
        return True

    async def names(self, prefix: str = "") -> AsyncIterator[str]:
        own = self._place.prefix
        with _told():
            pages = self._client.get_paginator("list_objects_v2").paginate(
                Bucket=self._place.bucket, Prefix=own + prefix
            )
            async for page in pages:
                for found in page.get("Contents", ()):
                    yield found["Key"].removeprefix(own)


def _code(error: ClientError) -> str:
    return str(error.response.get("Error", {}).get("Code", ""))


@contextmanager
def _told() -> Iterator[None]:
    """Turn the library's errors into STORE_UNAVAILABLE, without what they quote of the request."""
    try:
        yield
    except ClientError as error:
        code = _code(error)
        detail = f"The S3 server refuses with {code or 'an error'}. {_HINTS.get(code, '')}".strip()
        raise BlockRobotError("STORE_UNAVAILABLE", detail) from error
    except (BotoCoreError, aiohttp.ClientError, OSError, TimeoutError) as error:
        detail = f"The S3 server does not answer as it should ({type(error).__name__})."
        raise BlockRobotError("STORE_UNAVAILABLE", detail) from error
