"""The node's certificate and its TLS 1.3 contexts: mutual with peers, one-sided for clients.

Rebuilt when CAs or certificate change; validity dates are left to `identity`.
"""

from __future__ import annotations

import contextlib
import fcntl
import socket
import ssl
import struct
import sys
import termios
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import structlog
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from consensus.errors import BlockRobotError
from node.directory.node_directory import DirectoryContent
from node.limits.work_costs import RECORD_US
from node.p2p.identity import UNREADABLE, CertificateFacts, load_authorities, read_facts
from pages.time_format import format_utc_time

EXPIRY_WARNING_MS = 30 * 24 * 3600 * 1000
_ANY = ""
_NO_CHECK_TIME = 0x200000  # X509_V_FLAG_NO_CHECK_TIME of OpenSSL, for which the ssl module has no name

RECORD_OVERHEAD_BYTES = 22
"""What a record of TLS 1.3 has besides its content, at least."""
_RECORD_MAX_BYTES = 17 * 1024
"""A part of so much may be here of a record that is not whole yet."""
_TCP_INFO_BYTES, _RECEIVED_AT_BYTES = 136, 128
_RECEIVED = struct.Struct("@Q")
_UNREAD = struct.Struct("@i")

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class OwnCertificate:
    """The node's certificate as last read, with its files' stamp."""

    facts: CertificateFacts
    stamp: tuple[int, ...]

    def state(self, now_ms: int) -> Literal["valid", "expiring", "expired"]:
        """Return its state; `expiring` means the last thirty days."""
        if self.facts.is_expired(now_ms):
            return "expired"
        return "expiring" if now_ms + EXPIRY_WARNING_MS > self.facts.not_after_ms else "valid"

    def sentence(self, now_ms: int) -> str:
        verb = "expired on" if self.facts.is_expired(now_ms) else "expires on"
        return f"The certificate {self.facts.serial_hex} of {self.facts.name} {verb} {self.facts.expires}."

    def describe(self, now_ms: int) -> dict[str, Any]:
        return {
            "serial": self.facts.serial_hex,
            "state": self.state(now_ms),
            "not_before_ms": self.facts.not_before_ms,
            "not_after_ms": self.facts.not_after_ms,
            "expires": format_utc_time(self.facts.not_after_ms),
        }


class Credentials:
    """One node's certificate and key files, and the contexts made from them."""

    def __init__(self, certificate_path: Path, key_path: Path, directory: DirectoryContent) -> None:
        """Raises CONFIGURATION_INVALID for unusable files, GENESIS_INVALID without any CA."""
        self._certificate_path = certificate_path
        self._key_path = key_path
        self._authorities = _authorities(directory)
        self.own = self._read_own()
        self.accepting = self._accepting_context(self._authorities)
        self._by_organisation: dict[tuple[ssl._SSLMethod, str], ssl.SSLContext] = {}
        self.serving = self._client_context()
        """For clients, which show no certificate."""

    def trust(self, directory: DirectoryContent) -> bool:
        """Trust these CAs from the next handshake; return whether they changed.

        On CONFIGURATION_INVALID or GENESIS_INVALID the old ones stay.
        """
        authorities = _authorities(directory)
        if authorities == self._authorities:
            return False
        self.accepting = self._accepting_context(authorities)
        self._authorities = authorities
        self._by_organisation.clear()
        return True

    def reload(self) -> bool:
        """Use a changed certificate from the next handshake; return whether it changed.

        On CONFIGURATION_INVALID (half-written files) the old one stays.
        """
        if self._stamp() == self.own.stamp:
            return False
        own, serving = self._read_own(), self._client_context()
        self.accepting = self._accepting_context(self._authorities)
        self.own, self.serving = own, serving
        self._by_organisation.clear()
        return True

    def dialling(self, organisation: str) -> ssl.SSLContext:
        """For a node of this organisation. Raises CONFIGURATION_INVALID, GENESIS_INVALID."""
        return self._context_of(ssl.PROTOCOL_TLS_CLIENT, organisation)

    def _accepting_context(self, authorities: Mapping[str, str]) -> ssl.SSLContext:
        context = self._peer_context(ssl.PROTOCOL_TLS_SERVER, authorities[_ANY])
        context.sni_callback = self._narrow_to
        return context

    def _narrow_to(self, handshake: ssl.SSLObject, organisation: str | None, _context: ssl.SSLContext) -> None:
        """The dialler says whose it is: no other organisation's authority has a say then, whatever that looks like."""
        if organisation is not None and organisation in self._authorities:
            with contextlib.suppress(BlockRobotError):
                handshake.context = self._context_of(ssl.PROTOCOL_TLS_SERVER, organisation)

    def _context_of(self, protocol: ssl._SSLMethod, organisation: str) -> ssl.SSLContext:
        if (protocol, organisation) not in self._by_organisation:
            authorities = self._authorities.get(organisation, "")
            self._by_organisation[protocol, organisation] = self._peer_context(protocol, authorities)
        return self._by_organisation[protocol, organisation]

    def _peer_context(self, protocol: ssl._SSLMethod, authorities: str) -> ssl.SSLContext:
        context = self._new_context(protocol)
        context.check_hostname = False
        context.verify_mode = ssl.CERT_REQUIRED
        context.verify_flags = ssl.VerifyFlags(context.verify_flags | _NO_CHECK_TIME | ssl.VERIFY_X509_PARTIAL_CHAIN)
        if protocol == ssl.PROTOCOL_TLS_SERVER:
            context.num_tickets = 0
        if authorities:
            try:
                context.load_verify_locations(cadata=authorities)
            except ssl.SSLError:
                raise BlockRobotError("GENESIS_INVALID", "A CA certificate of the directory cannot be used.") from None
        return context

    def _client_context(self) -> ssl.SSLContext:
        context = self._new_context(ssl.PROTOCOL_TLS_SERVER)
        context.set_alpn_protocols(["http/1.1"])
        return context

    def _new_context(self, protocol: ssl._SSLMethod) -> ssl.SSLContext:
        context = ssl.SSLContext(protocol)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        try:
            context.load_cert_chain(self._certificate_path, self._key_path)
        except (ssl.SSLError, OSError):
            raise BlockRobotError(
                "CONFIGURATION_INVALID", "The node's TLS certificate or key cannot be read, or they do not fit."
            ) from None
        return context

    def _stamp(self) -> tuple[int, ...]:
        try:
            states = [path.stat() for path in (self._certificate_path, self._key_path)]
        except OSError:
            return ()
        return tuple(number for state in states for number in (state.st_mtime_ns, state.st_size, state.st_ino))

    def _read_own(self) -> OwnCertificate:
        stamp = self._stamp()
        try:
            certificate = x509.load_pem_x509_certificate(self._certificate_path.read_bytes())
        except (OSError, *UNREADABLE):
            raise BlockRobotError("CONFIGURATION_INVALID", "The node's TLS certificate cannot be read.") from None
        return OwnCertificate(facts=read_facts(certificate), stamp=stamp)


def read_private_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """Raises FILE_UNUSABLE."""
    try:
        key = load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError, TypeError):
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise BlockRobotError("FILE_UNUSABLE", f"The TLS key {path} cannot be read; renew with --new-key.")
    return key


def _authorities(directory: DirectoryContent) -> Mapping[str, str]:
    """Return each organisation's CA certificates, and those of all active ones (`_ANY`). Raises GENESIS_INVALID.

    Removed organisations' are for their own nodes, which are told why they count no more. Each is re-encoded as PEM, so
    no other text reaches the TLS library.
    """
    readable = {_ANY: ""}
    for name, organisation in sorted(directory.organisations.items()):
        certificates = load_authorities(organisation.ca_certificate)
        if not certificates:
            log.error("authority_unreadable", organisation=name)
            continue
        readable[name] = "".join(certificate.public_bytes(Encoding.PEM).decode() for certificate in certificates)
        if organisation.is_active:
            readable[_ANY] += readable[name]
    if not readable[_ANY]:
        raise BlockRobotError("GENESIS_INVALID", "No CA certificate of the directory can be read.")
    return readable


def pass_over_strange_names(fault: sys.UnraisableHookArgs) -> None:
    """For `sys.unraisablehook`: a stranger's server name beyond ASCII is told there by the ssl module, each time."""
    if not isinstance(fault.object, bytes):
        sys.__unraisablehook__(fault)


def read_bytes(transport_socket: Any) -> int | None:
    """None where unsupported."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        tcp_info = transport_socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_BYTES)
        unread = fcntl.ioctl(transport_socket.fileno(), termios.FIONREAD, bytes(_UNREAD.size))
    except OSError:
        return None
    if len(tcp_info) < _TCP_INFO_BYTES:
        return None
    return int(_RECEIVED.unpack_from(tcp_info, _RECEIVED_AT_BYTES)[0]) - int(_UNREAD.unpack(unread)[0])


class TlsOverhead:
    """Record overhead of one connection, as a cost besides its frames'; counts no byte twice."""

    def __init__(self, transport_socket: Any) -> None:
        self._socket = transport_socket
        self._begun = None if transport_socket is None else read_bytes(transport_socket)
        self._content_bytes = 0
        self._paid_bytes = 0

    def cost_us(self, content_bytes: int) -> int:
        """Return records' cost since the last call, given its content bytes."""
        self._content_bytes += content_bytes
        now = None if self._begun is None else read_bytes(self._socket)
        if now is None or self._begun is None:
            return 0
        unpaid = now - self._begun - self._content_bytes - _RECORD_MAX_BYTES - self._paid_bytes
        records = max(0, unpaid) // RECORD_OVERHEAD_BYTES
        self._paid_bytes += records * RECORD_OVERHEAD_BYTES
        return records * RECORD_US
