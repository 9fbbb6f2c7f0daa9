"""Addresses of nodes that the user gives, typed or in a file beside the genesis: hints; certificates and proofs judge."""

from __future__ import annotations

import asyncio
import re
import ssl
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

import msgspec
from cryptography import x509
from cryptography.x509.oid import NameOID

from clients.sdk.connections import CONNECT_TIMEOUT_MS, NodeAddress, check_address
from clients.sdk.new_files import read_given_text
from clients.sdk.node_hints import HINTS
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError
from consensus.visible_text import one_entry

NODES_FILE_MAX_BYTES = 64 * 1024
GIVEN_NODES_MAX_COUNT = 64
GIVEN_URL_MAX_CHARS = 512
GIVEN_TIMEOUT_MS = 5_000
_PRINTED = re.compile(r"[!-\[\]-~]+")
"""Visible ASCII without the backslash, which readers of URLs take for different things."""


@dataclass(frozen=True, slots=True)
class GivenNode:
    """A URL, and whose it is said to be; without a name the certificate says that."""

    url: str
    name: str = ""

    @property
    def place(self) -> str:
        """Host and port, as an error names them."""
        return one_entry(urlsplit(self.url).netloc)


@dataclass(frozen=True, slots=True)
class Claim:
    """What a certificate says of its holder, unchecked."""

    name: str
    organisation: str


class _Entry(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    url: str


class _NodesFile(msgspec.Struct, forbid_unknown_fields=True):
    nodes: list[_Entry]


def _wrong(sentence: str) -> BlockRobotError:
    return BlockRobotError("NODE_ADDRESS_UNUSABLE", sentence)


def check_given(url: str, name: str = "") -> GivenNode:
    """`https://HOST:PORT`, or `http` on loopback. Raises NODE_ADDRESS_UNUSABLE, which never quotes a password."""
    name = one_entry(name)
    of = f" of {name!r}" if name else ""
    if len(url) > GIVEN_URL_MAX_CHARS or not _PRINTED.fullmatch(url):
        raise _wrong(f"The address{of} is no URL.")
    try:
        parts = urlsplit(url)
        is_bare = parts.path in {"", "/"} and not parts.query and not parts.fragment and parts.port != 0
    except ValueError:
        raise _wrong(f"The address{of} is no URL.") from None
    if "@" in parts.netloc:
        raise _wrong(f"The address{of} holds a user name or a password; a node takes neither.")
    try:
        check_address(NodeAddress(name, url))
    except BlockRobotError as error:
        raise _wrong(error.detail) from None
    if not is_bare:
        raise _wrong(f"The address{of} has more than a host and a port.")
    return GivenNode(url.rstrip("/"), name)


def read_given(text: str) -> GivenNode:
    """`URL` or `NAME=URL`. Raises NODE_ADDRESS_UNUSABLE."""
    name, mark, url = text.partition("=")
    return check_given(url, name) if mark and "/" not in name else check_given(text)


def read_nodes_file(path: Path) -> tuple[list[GivenNode], list[BlockRobotError]]:
    """The usable entries, and what is wrong with the others, or with the file."""
    try:
        document = read_json_as(read_given_text(path, NODES_FILE_MAX_BYTES), _NodesFile)
    except BlockRobotError as error:
        return [], [error]
    except (OSError, TextInvalidError):
        return [], [BlockRobotError("FILE_UNUSABLE", f"{path} lists no nodes: it cannot be read, or has another form.")]
    if len(document.nodes) > GIVEN_NODES_MAX_COUNT:
        return [], [BlockRobotError("FILE_UNUSABLE", f"{path} lists more than {GIVEN_NODES_MAX_COUNT} nodes.")]
    given, refusals = list[GivenNode](), list[BlockRobotError]()
    for entry in document.nodes:
        try:
            given.append(check_given(entry.url, entry.name))
        except BlockRobotError as error:
            refusals.append(error)
    return given, refusals


async def read_claim(given: GivenNode) -> Claim:
    """Who the server there says it is, which the next connection checks. Raises NODE_ADDRESS_WRONG, NODE_UNREACHABLE."""
    parts = urlsplit(given.url)
    if parts.scheme != "https":
        raise _wrong(f"{given.place} is plain HTTP, where no certificate says which node it is: give NAME=URL.")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_MS / 1000):
            _, writer = await asyncio.open_connection(parts.hostname, parts.port or 443, ssl=context)
    except ssl.SSLError:
        raise BlockRobotError("NODE_ADDRESS_WRONG", f"{given.place} does not speak TLS.") from None
    except (OSError, TimeoutError, UnicodeError) as error:  # the last: a name that IDNA refuses
        sentence = f"Nobody answers at {given.place} ({type(error).__name__})."
        raise BlockRobotError("NODE_UNREACHABLE", sentence) from None
    shown = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    writer.transport.abort()
    try:
        subject = x509.load_der_x509_certificate(shown or b"").subject
        name, organisation = (
            str(subject.get_attributes_for_oid(oid)[0].value)
            for oid in (NameOID.COMMON_NAME, NameOID.ORGANIZATION_NAME)
        )
    except (ValueError, IndexError, x509.InvalidVersion):
        raise BlockRobotError("NODE_ADDRESS_WRONG", f"{given.place} shows no node's certificate.") from None
    return Claim(name, organisation)


class GivenTo(Protocol):
    """The part of a `NetworkClient` that takes given nodes."""

    async def use_given(self, given: Sequence[GivenNode]) -> list[BlockRobotError]:
        """Return why some are not used."""


async def use_given_nodes(client: GivenTo, chain_id: bytes) -> None:
    """Tell a client what the user said; tell the user what is not used, and why."""
    typed, file = HINTS.read(chain_id)
    given, refusals = [read_given(text) for text in typed], list[BlockRobotError]()
    if file is not None:
        listed, refusals = read_nodes_file(file)
        given += listed
    if given:
        refusals += await client.use_given(given)
    for refusal in refusals:
        HINTS.tell(refusal)
