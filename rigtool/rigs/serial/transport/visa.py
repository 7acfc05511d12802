"""An instrument at GPIB, USB or a network, with the methods of a serial port, by PyVISA.

    visa:GPIB0::22::INSTR        visa:USB0::0x2A8D::0x0101::MY123::INSTR?backend=@py

What follows `backend=` is PyVISA's name of a VISA library; without it PyVISA finds one.
"""

from __future__ import annotations

import time
from typing import Any

from rigtool.errors import UsageError

ANSWER_TIME = 5.0
"""Longest time in which an instrument answers, s."""


class VisaPort:
    """An open instrument; raises OSError or ValueError where it cannot be opened.

    It is read only after a question was written: an instrument takes a reading without a question
    as an error. Raises `UsageError` without PyVISA.
    """

    in_waiting = 65536
    """Not known: a read returns the whole answer, up to this number of bytes."""

    def __init__(self, address: str, timeout: float) -> None:
        try:
            import pyvisa
        except ImportError:
            raise UsageError(
                "a port visa:... needs the package pyvisa, that is not installed: "
                "pip install rigtool[visa]"
            ) from None
        self._visa, self._pause = pyvisa, timeout
        self._questions, self._answer = 0, b""
        name, _, option = address.partition("?")
        try:
            manager = pyvisa.ResourceManager(option.removeprefix("backend="))
            self._resource: Any = manager.open_resource(name)
            if not isinstance(self._resource, pyvisa.resources.MessageBasedResource):
                raise ValueError(f"{name!r} is no instrument that is asked by messages")
            self._resource.timeout = ANSWER_TIME * 1e3
        except (pyvisa.Error, ValueError, OSError, AttributeError) as error:
            raise ValueError(f"{error}") from None

    def write(self, data: bytes) -> None:
        """Send bytes; each `?` in them is a question."""
        try:
            self._resource.write_raw(data.lstrip(b"\n"))  # it holds no rest of a question
        except self._visa.Error as error:
            raise OSError(str(error)) from None
        self._questions += data.count(b"?")

    def read(self, size: int = 1) -> bytes:
        """Return the answer to a question, its end included; empty where there is none."""
        if not self._answer:
            self._answer = self._receive()
        data, self._answer = self._answer[:size], self._answer[size:]
        return data

    def _receive(self) -> bytes:
        if not self._questions:
            time.sleep(self._pause)
            return b""
        self._questions -= 1
        try:
            answer: bytes = self._resource.read_raw()
        except self._visa.VisaIOError as error:
            if error.error_code == self._visa.constants.StatusCode.error_timeout:
                return b""
            raise OSError(str(error)) from None
        return answer.rstrip(b"\r\n") + b"\n"  # the end of a message may be a line of its own

    def close(self) -> None:
        """Close the instrument."""
        self._resource.close()
