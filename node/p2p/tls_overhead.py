"""Cost of reading besides frames: TLS record overhead (22 bytes each); counts no byte twice."""

from __future__ import annotations

import fcntl
import socket
import struct
import sys
import termios
from typing import Any

from node.budgets.work_costs import RECORD_US

RECORD_OVERHEAD_BYTES = 22
"""What a record of TLS 1.3 has besides its content, at least."""
_RECORD_MAX_BYTES = 17 * 1024
"""A part of so much may be here of a record that is not whole yet."""
_TCP_INFO_BYTES, _RECEIVED_AT_BYTES = 136, 128
_RECEIVED = struct.Struct("@Q")
_UNREAD = struct.Struct("@i")


def read_bytes(transport_socket: Any) -> int | None:
    """Return bytes read from a TCP socket; None where unsupported."""
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
    """TLS record overhead bytes of one connection."""

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
