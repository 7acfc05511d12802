"""An emulated device on a pseudo-terminal, or on a TCP socket, in a thread of its own."""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import threading
import time
from collections.abc import Iterator

from rigtool.errors import HardwareError, UsageError

IDLE_TIME = 0.002
"""Longest time between two calls of `Emulator.idle`, s."""

READ_BYTES = 65536

BACKLOG_BYTES = 1 << 14
"""Bytes that wait to be sent at which a device that sends unasked is held up.

An answer waits behind them: few enough that it comes in time on any line that carries the stream.
"""

MAX_PORT = 65535

UNREAD_TIME = 1.0
"""Time after which bytes that nobody reads are dropped, s."""


class Pulled(Exception):
    """The cable is pulled: the server closes its side and ends."""


class Emulator:
    """A device: bytes in, bytes out. Subclasses implement `receive` and, if needed, the others.

    All methods are called from the server's thread. Bytes arrive in pieces of any size: keep
    incomplete requests.
    """

    busy = False
    """Whether `idle` has work to do at once."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the host and return the answer."""
        raise NotImplementedError

    def idle(self) -> bytes:
        """Return bytes sent without a request; called every `IDLE_TIME` s at least.

        Watchdogs expire and motors turn here.
        """
        return b""

    def reset(self) -> None:
        """Restart, as after a loss of power; settings are lost."""

    def refuse(self, count: int) -> None:
        """Refuse the next `count` requests, as the device would with an error of its own."""


class Server:
    """Serves an emulator; the host opens `port`. End it with `stop`."""

    def __init__(self, emulator: Emulator) -> None:
        self.emulator = emulator
        self.port = ""
        self.error: BaseException | None = None
        self._stop = threading.Event()
        self._waiting = bytearray()
        self._taken = time.monotonic()
        self._thread = threading.Thread(target=self._serve, name="emulator", daemon=True)

    def start(self) -> None:
        """Open the port and serve."""
        self._open()
        self._thread.start()

    def stop(self) -> None:
        """End serving and close the port."""
        self._stop.set()
        self._thread.join()

    def wait(self, seconds: float | None = None) -> None:
        """Serve until interrupted, or for so many seconds."""
        end = math.inf if seconds is None else time.monotonic() + seconds
        while self._thread.is_alive() and (left := end - time.monotonic()) > 0:
            self._thread.join(min(left, 0.2))

    def _serve(self) -> None:
        try:
            while not self._stop.is_set() and self.serve_once():
                pass
        finally:
            self._close()

    def serve_once(self) -> bool:
        """Wait for bytes, `IDLE_TIME` at most, and serve them; return whether the line is still
        there.

        An error is kept in `error`.
        """
        try:
            ready = self._ready(0.0 if self.emulator.busy and not self._waiting else IDLE_TIME)
            if ready and (data := self._read()):
                self._waiting += self.emulator.receive(data)
            if len(self._waiting) < BACKLOG_BYTES:
                self._waiting += self.emulator.idle()
            self._send()
        except Pulled:
            return False
        except OSError as error:
            self.error = error
            return False
        except BaseException as error:  # a mistake in an emulator: tests look here
            self.error = error
            raise
        return True

    def _send(self) -> None:
        """Send waiting bytes. Bytes that nobody reads for a while are lost, as on a real line."""
        now = time.monotonic()
        sent = self._write(self._waiting) if self._waiting else 0
        del self._waiting[:sent]
        if sent or not self._waiting:
            self._taken = now
        elif now - self._taken > UNREAD_TIME:
            self._waiting.clear()

    # -- transport

    def _open(self) -> None:
        raise NotImplementedError

    def _ready(self, timeout: float) -> bool:
        """Wait until bytes come or waiting ones can be sent; return whether bytes have come."""
        raise NotImplementedError

    def _read(self) -> bytes:
        raise NotImplementedError

    def _write(self, data: bytearray) -> int:
        """Send as much as is taken at once; return how much."""
        raise NotImplementedError

    def _close(self) -> None:
        raise NotImplementedError


class PtyServer(Server):
    """An emulator on a pseudo-terminal; `port` is its path."""

    def _open(self) -> None:
        try:
            import pty
            import tty
        except ImportError:
            raise HardwareError(
                "this system has no pseudo-terminals: serve the emulator with --tcp"
            ) from None
        self._master, self._slave = pty.openpty()
        # Raw, and our own slave stays open: else a client that closes breaks the master's reads.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)

    def _ready(self, timeout: float) -> bool:
        writing = [self._master] if self._waiting else []
        return bool(select.select([self._master], writing, [], timeout)[0])

    def _read(self) -> bytes:
        return os.read(self._master, READ_BYTES)

    def _write(self, data: bytearray) -> int:
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def _close(self) -> None:
        os.close(self._slave)
        os.close(self._master)


class TcpServer(Server):
    """An emulator on a TCP socket, one host at a time; `port` is a URL of pyserial."""

    def __init__(self, emulator: Emulator, address: str = "127.0.0.1:0") -> None:
        super().__init__(emulator)
        self._address = address
        self._host: socket.socket | None = None

    def _open(self) -> None:
        name, _, number = self._address.rpartition(":")
        if not name or not number.isdecimal() or int(number) > MAX_PORT:
            raise UsageError(
                f"--tcp {self._address}: is no address: give HOST:PORT, PORT from 0 to {MAX_PORT}, "
                "e.g. 127.0.0.1:7077"
            )
        try:
            self._listening = socket.create_server((name, int(number)))
        except OSError as error:
            raise HardwareError(
                f"--tcp {self._address}: cannot listen there: {error}; give HOST:PORT"
            ) from None
        name, number = self._listening.getsockname()[:2]
        self.port = f"socket://{name}:{number}"

    def _ready(self, timeout: float) -> bool:
        waiting = self._listening if self._host is None else self._host
        writing = [self._host] if self._host is not None and self._waiting else []
        if not select.select([waiting], writing, [], timeout)[0]:
            return False
        if self._host is None:
            self._host, _ = self._listening.accept()
            self._host.setblocking(False)
            self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return False
        return True

    def _read(self) -> bytes:
        assert self._host is not None
        try:
            data = self._host.recv(READ_BYTES)
        except ConnectionError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def _write(self, data: bytearray) -> int:
        if self._host is None:
            return len(data)
        try:
            return self._host.send(data)
        except BlockingIOError:
            return 0
        except ConnectionError:
            self._hang_up()
            return len(data)

    def _hang_up(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None

    def _close(self) -> None:
        self._hang_up()
        self._listening.close()


@contextlib.contextmanager
def serve(emulator: Emulator, *, tcp: bool = False) -> Iterator[Server]:
    """Serve an emulator while the `with` block runs: on a pseudo-terminal, or on a TCP socket."""
    server = TcpServer(emulator) if tcp else PtyServer(emulator)
    server.start()
    try:
        yield server
    finally:
        server.stop()
