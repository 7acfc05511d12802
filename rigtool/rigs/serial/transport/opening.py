"""A port by its name: a serial port, a socket, a CAN bus, an instrument of VISA, or a record."""

from __future__ import annotations

import errno
from typing import Any

from rigtool.errors import HardwareError
from rigtool.rigs.serial.transport.can import CanPort
from rigtool.rigs.serial.transport.sockets import Socket
from rigtool.rigs.serial.transport.spy import Replay
from rigtool.rigs.serial.transport.visa import VisaPort

REPLAY_PREFIX = "replay://"
SOCKET_PREFIX = "socket://"
CAN_PREFIX = "can:"
VISA_PREFIX = "visa:"
USUAL_CHARACTER = "8N1"
"""Data bits, parity and stop bits of a character, where nothing else is stated."""

READ_TIME = 0.01
"""Longest that one read of the port waits, s: deadlines are kept as closely."""


def open_port(port: str, baud_rate: int, frame: str, exclusive: bool | None = True) -> Any:
    """Return the open port of this name.

    `frame` is that of a character, `8N1`, say; `exclusive` only concerns serial ports. Raises
    `HardwareError`, with the remedy, where the port cannot be opened.
    """
    if port.startswith(REPLAY_PREFIX):
        return Replay(port.removeprefix(REPLAY_PREFIX))
    import serial

    try:
        if port.startswith(SOCKET_PREFIX):
            return Socket(port.removeprefix(SOCKET_PREFIX), READ_TIME)
        if port.startswith(CAN_PREFIX):
            return CanPort(port.removeprefix(CAN_PREFIX), baud_rate, READ_TIME)
        if port.startswith(VISA_PREFIX):
            return VisaPort(port.removeprefix(VISA_PREFIX), READ_TIME)
        return serial.serial_for_url(
            port,
            baudrate=baud_rate,
            bytesize=int(frame[0]),
            parity=frame[1],
            stopbits=int(frame[2]),
            timeout=READ_TIME,
            write_timeout=1.0,
            exclusive=exclusive,
        )
    except (OSError, ValueError) as error:
        raise HardwareError(f"{port}: cannot be opened: {_why(error)}") from None


def _why(error: OSError | ValueError) -> str:
    number = getattr(error, "errno", None)
    text = str(error)
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text:
        return "another program has it open: close that one"
    if number == errno.ENOENT or "FileNotFoundError" in text:
        return "there is no such port; `rigtool devices` lists those there are"
    if number == errno.EISDIR or "Inappropriate ioctl" in text:
        return "this is no serial port; `rigtool devices` lists those there are"
    if number == errno.EACCES or "PermissionError" in text:
        return (
            "permission denied: on Linux your user must be in the group of the port (often "
            "dialout); on Windows another program has it open"
        )
    if "Connection refused" in text or number == errno.ECONNREFUSED:
        return "nothing listens at this address: start the program that serves it first"
    return text
