"""A TCP connection with the methods of a serial port that a `Line` uses.

pyserial's own `socket://` reads byte by byte and delays small writes.
"""

from __future__ import annotations

import select
import socket


class Socket:
    """A connection to HOST:PORT; raises OSError or ValueError where there is none."""

    in_waiting = 65536
    """Not known: a read returns the available bytes, up to this number."""

    def __init__(self, address: str, timeout: float) -> None:
        host, _, port = address.split("?")[0].rstrip("/").rpartition(":")
        self._timeout = timeout
        if not host or not port.isdecimal() or int(port) > 65535:
            raise ValueError(f"{address!r} is no address: give socket://HOST:PORT")
        self._socket = socket.create_connection((host, int(port)), timeout=5.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(1.0)

    def read(self, size: int = 1) -> bytes:
        """Return the available bytes, at most `size`; empty after the timeout.

        Raises `ConnectionError` where the other side has closed.
        """
        if not select.select([self._socket], [], [], self._timeout)[0]:
            return b""
        data = self._socket.recv(size)
        if not data:
            raise ConnectionError("the other side has closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send all of the bytes."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
