"""The common part of maxon drives on a serial line: repeated samples, and the guard."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

from rigtool.errors import HardwareError
from rigtool.rigs.serial.cia402.states import Place, RestoredDrive
from rigtool.rigs.serial.drive import Mode, Sample, SetPoint
from rigtool.rigs.serial.maxon.guard import UNWATCHED, Guard

SAMPLE_ATTEMPTS = 5

NO_WATCHDOG = f"has no watchdog on this line: {UNWATCHED}"


class MaxonDrive(RestoredDrive[Place]):
    """A drive that answers several requests a sample."""

    guard: Guard | None = None

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
        """Switch the power stage off, in any state; the guard rests then."""
        super().halt()
        if self.guard is not None:
            self.guard.rest()

    def restore(self) -> None:
        """Restore the changed settings; the guard ends."""
        try:
            super().restore()
        finally:
            if self.guard is not None:
                self.guard.close()
