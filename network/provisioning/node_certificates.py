"""Creates, renews and reports nodes' certificates.

An authority is a folder, named as the organisation, with `ca.crt.pem` and `ca.key.pem`. Renewal keeps the node's key by
default, so one file changes atomically.
"""

from __future__ import annotations

import datetime as dt
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from clients.sdk.new_files import require_seen
from consensus.errors import BlockRobotError
from network.provisioning.certificate_authority import (
    AUTHORITY_CERTIFICATE_FILE,
    AUTHORITY_KEY_FILE,
    NODE_LIFETIME_DAYS,
    Authority,
    certified_hosts,
    issue_node_certificate,
    load_authority,
    write_secret,
)
from node.config import NodeConfig
from node.p2p.identity import UNREADABLE, CertificateFacts, read_facts
from node.p2p.tls import EXPIRY_WARNING_MS, read_private_key

CERTIFICATE_FILE = "tls.crt.pem"
KEY_FILE = "tls.key.pem"
SERIAL_SIZE_BYTES = 20
DAY_MS = 24 * 3600 * 1000
CertificateState = Literal["valid", "expiring", "expired", "revoked", "unusable"]


@dataclass(frozen=True, slots=True)
class CertificateReport:
    """A node's certificate on disk; `trouble` is what is wrong, if anything."""

    node: str
    facts: CertificateFacts | None
    trouble: str

    def state(self, now_ms: int, revoked: frozenset[tuple[str, int]] = frozenset()) -> CertificateState:
        if self.facts is None or self.trouble:
            return "unusable"
        if (self.facts.organisation, self.facts.serial) in revoked:
            return "revoked"
        if self.facts.is_expired(now_ms):
            return "expired"
        return "expiring" if self.days_left(now_ms) * DAY_MS < EXPIRY_WARNING_MS else "valid"

    def days_left(self, now_ms: int) -> int:
        """Whole days; negative if expired."""
        return -1 if self.facts is None else (self.facts.not_after_ms - now_ms) // DAY_MS


def now_ms() -> int:
    return time.time_ns() // 1_000_000


def serial_bytes(serial: int) -> bytes:
    """Return a serial as the contract `membership` takes it: 20 bytes, big-endian."""
    return serial.to_bytes(SERIAL_SIZE_BYTES, "big")


def parse_serial(text: str) -> int:
    """Parse a hexadecimal serial number. Raises SERIAL_INVALID."""
    try:
        serial = int(text.replace(":", ""), 16)
    except ValueError:
        serial = -1
    if not 0 < serial < 1 << (8 * SERIAL_SIZE_BYTES):
        raise BlockRobotError("SERIAL_INVALID", f"{text!r} is no serial number.")
    return serial


def read_certificate(config: NodeConfig) -> x509.Certificate:
    """Raises CERTIFICATE_UNFIT if it cannot be read."""
    try:
        return x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes())
    except (OSError, *UNREADABLE):
        raise BlockRobotError("CERTIFICATE_UNFIT", "The node's certificate cannot be read.") from None


def read_report(config: NodeConfig) -> CertificateReport:
    try:
        certificate = x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes())
        facts = read_facts(certificate)
    except (OSError, *UNREADABLE):
        return CertificateReport(config.name, None, "The certificate cannot be read.")
    trouble = ""
    try:
        key = load_pem_private_key(config.tls_key_path.read_bytes(), None)
        if key.public_key() != certificate.public_key():
            trouble = "The key is not that of the certificate."
    except (OSError, ValueError, TypeError):
        trouble = "The key cannot be read."
    if not trouble and facts.name != config.name:
        trouble = f"The certificate names {facts.name!r}, not this node."
    return CertificateReport(config.name, facts, trouble)


def issue_into(folder: Path, authority: Authority, name: str, *hosts: str, days: int = NODE_LIFETIME_DAYS) -> int:
    """Return the serial. Raises FileExistsError."""
    for path in (folder / KEY_FILE, folder / CERTIFICATE_FILE):
        if path.exists():  # before the first is written: half of a pair would not fit the other's half
            raise FileExistsError(path)
    issued = issue_node_certificate(authority, name, *hosts, lifetime=dt.timedelta(days=days))
    write_secret(folder / KEY_FILE, issued.key_pem)
    write_secret(folder / CERTIFICATE_FILE, issued.certificate_pem)
    return issued.serial


def renew(
    config: NodeConfig,
    authority: Authority,
    *,
    days: float = NODE_LIFETIME_DAYS,
    new_key: bool = False,
    hosts: Sequence[str] = (),
    check: Callable[[x509.Certificate], None] = lambda _made: None,
) -> int:
    """Return the new serial number; `hosts`: what the certificate names, else as the old one did.

    A running node reloads it within a second. The old one stays if `check` raises. Raises FILE_UNUSABLE if the kept key
    is unreadable.
    """
    key = None if new_key else read_private_key(config.tls_key_path)
    named = hosts or own_hosts(config)
    issued = issue_node_certificate(authority, config.name, *named, lifetime=dt.timedelta(days=days), key=key)
    check(x509.load_pem_x509_certificate(issued.certificate_pem))
    key_pair = [(config.tls_key_path, issued.key_pem)] if new_key else []
    _replace([*key_pair, (config.tls_certificate_path, issued.certificate_pem)])
    return issued.serial


def own_hosts(config: NodeConfig, otherwise: Sequence[str] = ()) -> tuple[str, ...]:
    """What the certificate on disk names; without a readable one `otherwise`, or where the node listens."""
    try:
        return certified_hosts(x509.load_pem_x509_certificate(config.tls_certificate_path.read_bytes()))
    except (OSError, *UNREADABLE):
        return tuple(otherwise) or (config.host,)


def install(config: NodeConfig, certificate: x509.Certificate) -> None:
    """Put a certificate for the node's own key in place of the old one."""
    _replace([(config.tls_certificate_path, certificate.public_bytes(Encoding.PEM))])


def _replace(pairs: Sequence[tuple[Path, bytes]]) -> None:
    """Replace files: write all in full, then rename, in this order."""
    fresh = []
    for path, data in pairs:
        temporary = path.with_name(path.name + ".new")
        temporary.unlink(missing_ok=True)
        write_secret(temporary, data)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        fresh.append((temporary, path))
    for temporary, path in fresh:
        temporary.replace(path)


def get_authority(network: Path, organisation: str, folder: Path | None = None) -> Authority:
    """From `folder` or the network's `organisations/`.

    Raises AUTHORITY_NOT_HERE without its key, FILE_UNUSABLE.
    """
    place = folder or network / "organisations" / organisation
    if not (place / AUTHORITY_KEY_FILE).is_file() or not (place / AUTHORITY_CERTIFICATE_FILE).is_file():
        require_seen(place.parent, AUTHORITY_KEY_FILE, place.name)
        raise BlockRobotError(
            "AUTHORITY_NOT_HERE", f"There is no {AUTHORITY_KEY_FILE} of the organisation {organisation!r} in {place}."
        )
    return load_authority(place, organisation)
