"""The common part of maxon drives: repeated samples, restored settings, switching off."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs.serial.drive import Mode, Sample, SetPoint
from rigtool.rigs.serial.line import Line, LineLost
from rigtool.rigs.serial.maxon.guard import Guard

Place = TypeVar("Place")

RPM = 2 * math.pi / 60
"""rad/s in one turn a minute."""

SAMPLE_ATTEMPTS = 5
HALT_ATTEMPTS = 3
RESTORE_ATTEMPTS = 3

STATE_READINGS = 50
STATE_PAUSE = 0.01
"""How often, and how far apart [s], a state is asked for that a drive is to reach."""

NO_WATCHDOG = (
    "has no watchdog on this line: if the computer or the cable fails, it follows its last "
    "set point until you stop it. If rigtool is killed or hangs, another process switches it off"
)


class MaxonDrive(ABC, Generic[Place]):
    """A drive that answers several requests a sample; positions come in quad counts.

    `Place` names a setting.
    """

    def __init__(self, line: Line, encoder_counts: int) -> None:
        self.line = line
        self._encoder_counts = encoder_counts
        self._count = 2 * math.pi / encoder_counts
        self._before: dict[Place, int] = {}
        self.guard: Guard | None = None

    @abstractmethod
    def _measure(self) -> tuple[Sample, int]:
        """Ask for all values of a sample, and for the status."""

    @abstractmethod
    def _set(self, setpoint: SetPoint) -> None:
        """Send the set point of the mode."""

    @abstractmethod
    def _require_on(self, status: int) -> None:
        """Raise `HardwareError` for the status of a drive that is not switched on."""

    @abstractmethod
    def _confirm(self) -> None:
        """Ask something with a known answer; raises `HardwareError` where another comes."""

    @abstractmethod
    def _switch_on(self, mode: Mode) -> None:
        """Switch on in a mode, with set points of zero."""

    @abstractmethod
    def _switch_off(self) -> bool:
        """Switch the power stage off with few attempts; return whether it is off."""

    @abstractmethod
    def _read_setting(self, place: Place) -> int:
        """Return a setting."""

    @abstractmethod
    def _write_setting(self, place: Place, value: int) -> None:
        """Change a setting."""

    def enable(self, mode: Mode) -> None:
        """Switch on in a mode, with set points of zero, once the guard watches."""
        if self.guard is not None:
            self.guard.watch()
        self._switch_on(mode)

    def step(self, setpoint: SetPoint) -> Sample:
        """Measure, then send a set point; raises `HardwareError` where the drive is off."""
        sample, status = self._undisturbed(lambda: self._set(setpoint))
        self._require_on(status)
        return sample

    def read(self) -> Sample:
        """Measure, in any state of the drive."""
        return self._undisturbed(self._confirm)[0]

    def _undisturbed(self, then: Callable[[], None]) -> tuple[Sample, int]:
        """Measure, call `then`, and do both again where anything had to be repeated.

        Answers do not name their question: a late one would be taken for the next. `then` notices
        it, since its answer is of another kind.
        """
        for _ in range(SAMPLE_ATTEMPTS):
            before = self.line.counts.retries
            measured = self._measure()
            then()
            if self.line.counts.retries == before:
                if self.guard is not None:
                    self.guard.beat()
                return measured
        raise HardwareError(
            f"{self.line.port}: no sample without damaged or missing answers in {SAMPLE_ATTEMPTS} "
            "attempts: see to cable, shield and earth"
        )

    def halt(self) -> None:
        """Switch the power stage off, in any state; `HardwareError` where it is not known to be."""
        problem: HardwareError | None = None
        for _ in range(HALT_ATTEMPTS):
            try:
                self.line.settle()  # late answers belong to older questions
                if self._switch_off():
                    if self.guard is not None:
                        self.guard.rest()
                    return
                problem = HardwareError("it reports that it is still on")
            except HardwareError as error:
                problem = error
        raise HardwareError(f"{self.line.port}: the drive was not switched off ({problem})")

    def restore(self) -> None:
        """Restore the changed settings, the last first; try refused ones again.

        Raises `HardwareError` where it is refused each time, `LineLost` where nothing answers.
        """
        problem: HardwareError | None = None
        for _ in range(RESTORE_ATTEMPTS):
            for place, value in reversed(list(self._before.items())):
                try:
                    self._write_setting(place, value)
                    del self._before[place]
                except LineLost:
                    raise
                except HardwareError as error:
                    problem = error
        if self.guard is not None:
            self.guard.close()
        if self._before and problem is not None:
            raise problem

    def _remember(self, place: Place) -> None:
        """Keep the value that a setting had at first."""
        if place not in self._before:
            self._before[place] = self._read_setting(place)

    def _change(self, place: Place, value: int, name: str) -> None:
        """Change a setting that is remembered, and see that it is changed."""
        self._write_setting(place, value)
        found = self._read_setting(place)
        if found != value:
            raise HardwareError(
                f"{self.line.port}: its {name} was set to {value}, and the drive has {found}:"
                " set it with maxon's program"
            )

    def _require_encoder(self, pulses: int | None) -> None:
        """Compare the drive's encoder, pulses a turn, with the recipe's; None where not known."""
        if pulses and 4 * pulses != self._encoder_counts:
            raise RecipeError(
                f"rig.encoder_counts is {self._encoder_counts}, the drive on {self.line.port} is "
                f"set to {pulses} pulses, {4 * pulses} counts a turn: correct the one that is wrong"
            )
