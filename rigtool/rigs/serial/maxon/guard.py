"""Stops a drive without watchdog when rigtool is killed or hangs, by another process beside it.

No maxon drive has a watchdog on its serial line, and SimpleFOC has none. While one is on, rigtool
sends a sign of life over a pipe to a second process. When the pipe falls silent or ends, that
process opens the port itself and switches the drive off. It does nothing against a computer or a
cable that fails: `serial.emergency_stop` is for those.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading

from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe.serial import Serial
from rigtool.rigs.serial.line import Line

UNWATCHED = (
    "if the computer or the cable fails, it follows its last set point until you stop it. If "
    "rigtool is killed or hangs, another process switches it off"
)
"""What a drive without watchdog does, for the operator."""

ON, OFF = b"1", b"0"
READY_BYTE = b"r"

SILENCE, SHORTEST_SILENCE = 2.0, 1.0
"""Silence that the guard accepts: multiple of `serial.watchdog`, and time [s] at least. The host
gives up first, and switching on takes a while."""


def make_guard(
    line: Line, settings: Serial, node: int, name: str, driver: str, baud_rate: int
) -> Guard | None:
    """Return the guard of a drive at a node, None where a record is played back.

    `baud_rate` is the usual one of the drive, in bit/s. Raises `RecipeError` for a recipe without
    an emergency stop.
    """
    if not settings.emergency_stop:
        raise RecipeError(
            f"{settings.port}: {name} no watchdog on this line: where computer or cable fail, the "
            "motor follows its last set point. Wire the enable or STO input, or the supply, to an "
            "emergency stop within reach, try it, and set serial.emergency_stop = true"
        )
    if line.replays:
        return None
    silence = max(SHORTEST_SILENCE, SILENCE * settings.watchdog)
    return Guard(settings.port, settings.baud_rate or baud_rate, node, silence, driver)


class Guard:
    """The host's end: starts the process when it is first needed.

    `silence` [s] is the longest time without a sign of life while the drive is on; `driver` names
    the module of the `Driver` that switches it off.
    """

    def __init__(
        self, port: str, baud_rate: int, node: int, silence: float, driver: str = "maxon"
    ) -> None:
        self._arguments = [driver, port, str(baud_rate), str(node), str(silence)]
        self._pipe: int | None = None
        self._on = False
        self.process: subprocess.Popen[bytes] | None = None

    def watch(self) -> None:
        """Announce that the drive is on, or about to be.

        Raises `HardwareError` where the process is gone.
        """
        if self._pipe is None:
            self._start()
        self._on = True
        self._send(ON)

    def beat(self) -> None:
        """Send a sign of life, if the drive is on."""
        if self._on:
            self._send(ON)

    def rest(self) -> None:
        """Announce that the drive is off."""
        if self._on:
            self._on = False
            with contextlib.suppress(HardwareError):  # it is not needed any more
                self._send(OFF)

    def close(self) -> None:
        """Close the pipe: the process ends."""
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None

    def _send(self, word: bytes) -> None:
        try:
            if self._pipe is None:
                raise BrokenPipeError
            os.write(self._pipe, word)
        except OSError:
            self.close()
            raise HardwareError(
                f"{self._arguments[1]}: the process that would switch the drive off where this one "
                "fails is gone: it was ended, or received nothing for "
                f"{float(self._arguments[-1]):.3g} s and acted (raise serial.watchdog)"
            ) from None

    def _start(self) -> None:
        theirs, self._pipe = os.pipe()
        if hasattr(os, "set_blocking"):  # one that was stopped and reads no more is gone, too
            os.set_blocking(self._pipe, False)
        answer, their_answer = os.pipe()
        # a Ctrl-C or Ctrl-Z at the terminal is not for it
        self.process = process = subprocess.Popen(
            [sys.executable, "-m", "rigtool.rigs.serial.maxon.guard_process", *self._arguments],
            stdin=theirs,
            stdout=their_answer,
            start_new_session=True,
        )
        os.close(theirs)
        os.close(their_answer)
        threading.Thread(target=process.wait, name="guard", daemon=True).start()
        ready = os.read(answer, 1)
        os.close(answer)
        if ready != READY_BYTE:
            self.close()
            raise HardwareError(
                f"{self._arguments[1]}: the process that would switch the drive off where this one "
                "is killed cannot be started"
            )
