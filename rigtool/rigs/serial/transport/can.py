"""A CAN bus with the methods of a serial port that a `Line` uses, by python-can.

    can:slcan:/dev/ttyACM0?bitrate=1000000       can:socketcan:can0       can:virtual:bench

What follows the `?` are arguments of python-can's interface. Frames go through the line as text
(`can_frames`), whatever the adapter: record, replay, counts and retries are those of a serial line.
"""

from __future__ import annotations

import contextlib
from typing import Any

from rigtool.errors import UsageError
from rigtool.rigs.serial.transport import can_frames as frames

SEND_TIMEOUT = 1.0
"""Longest time for which an adapter takes no frame, s."""

GARBLED_LINE = b"?" + frames.END
"""A line that is no frame."""

SAMPLE_POINT = 200 / 3
"""Where a bit of CAN FD is sampled, in percent, in case the timing is computed here: [moteus]."""


class CanPort:
    """An open bus; raises OSError or ValueError where it cannot be opened.

    `bit_rate` [bit/s] counts where the address has none. Raises `UsageError` without python-can.
    """

    in_waiting = 65536
    """Not known: a read returns a frame, or a part of one, up to this number of bytes."""

    def __init__(self, address: str, bit_rate: int, timeout: float) -> None:
        try:
            import can
        except ImportError:
            raise UsageError(
                "a port can:... needs the package python-can, that is not installed: "
                "pip install rigtool[can]"
            ) from None
        self._can, self._timeout, self._text = can, timeout, b""
        interface, _, rest = address.partition(":")
        channel, _, text = rest.partition("?")
        if not interface or not channel:
            raise ValueError(f"{address!r} is no address: give can:INTERFACE:CHANNEL")
        try:
            options = self._options(text, bit_rate)
            self._bus: Any = can.Bus(channel, interface, ignore_config=True, **options)
            if (port := self._serial_port) is not None:
                port.exclusive = True
        except (can.CanError, NotImplementedError, TypeError, KeyError) as error:
            cause = error.__cause__
            raise cause if isinstance(cause, OSError) else ValueError(str(error)) from None

    def _options(self, text: str, bit_rate: int) -> dict[str, Any]:
        """Return the arguments of an address; a timing of CAN FD where the clock is given."""
        given = dict(item.partition("=")[::2] for item in text.split("&") if item)
        options: dict[str, Any] = {"bitrate": bit_rate, "sleep_after_open": 0.0}
        options |= {name: self._can.util.cast_from_string(value) for name, value in given.items()}
        if "f_clock" in options and "data_bitrate" in options:
            options["timing"] = self._can.BitTimingFd.from_sample_point(
                f_clock=options.pop("f_clock"),
                nom_bitrate=options.pop("bitrate"),
                nom_sample_point=SAMPLE_POINT,
                data_bitrate=options.pop("data_bitrate"),
                data_sample_point=SAMPLE_POINT,
            )
        return options

    @property
    def _serial_port(self) -> Any:
        """The serial port of an slcan adapter, None for another."""
        return getattr(self._bus, "serialPortOrig", None)

    def read(self, size: int = 1) -> bytes:
        """Return the line of the next frame, or what is left of one; empty after the timeout."""
        if not self._text:
            self._text = self._receive()
        data, self._text = self._text[:size], self._text[size:]
        return data

    def _receive(self) -> bytes:
        try:
            message = self._bus.recv(self._timeout)
        except (ValueError, IndexError):
            return GARBLED_LINE  # python-can has dropped a line of slcan that it cannot read
        except self._can.CanError as error:
            if isinstance(error.__cause__, ValueError):
                self._bus.flush()  # else python-can would find these bytes before each later line
                return GARBLED_LINE
            raise OSError(str(error.__cause__ or error)) from None
        if message is None or message.is_error_frame:
            return b""
        frame = frames.CanFrame(
            message.arbitration_id,
            bytes(message.data),
            message.is_extended_id,
            message.is_remote_frame,
            message.is_fd,
        )
        cut = not frame.remote and len(frame.data) != message.dlc
        return GARBLED_LINE if cut else frames.encode(frame)

    def write(self, data: bytes) -> None:
        """Send the frames of these lines."""
        for line in data.split(frames.END)[:-1]:
            frame = frames.decode(line)
            message = self._can.Message(
                arbitration_id=frame.identifier,
                data=frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
                is_fd=frame.fd,
                bitrate_switch=frame.fd,
            )
            try:
                self._bus.send(message, SEND_TIMEOUT)
            except self._can.CanError as error:
                raise OSError(str(error.__cause__ or error)) from None

    def close(self) -> None:
        """Close the bus, also one whose adapter is gone."""
        with contextlib.suppress(self._can.CanError, OSError):
            self._bus.shutdown()
        if (port := self._serial_port) is not None:
            port.close()
