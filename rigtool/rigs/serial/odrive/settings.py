"""Settings of an axis: changed during a session, watched, and restored."""

from __future__ import annotations

from rigtool.errors import HardwareError
from rigtool.rigs.serial.odrive.text import OdriveProtocol, agrees, number


class Settings:
    """Properties below `prefix` that are not as their owner left them.

    A value is written only where it differs, since the drive reports no more than 9 characters of
    the original one. The original values are restored, also after a reset of the drive.
    """

    def __init__(self, protocol: OdriveProtocol, prefix: str) -> None:
        self._protocol, self._prefix = protocol, prefix
        self._before: dict[str, str] = {}
        self._ours: dict[str, str] = {}

    def begin(self) -> None:
        """Forget the changes, which a reset may have undone; keep the original values."""
        self._ours.clear()

    def remember(self, name: str) -> str:
        """Return a value, which may change from now on and comes back in the end."""
        now = self._protocol.get(self._prefix + name)
        self._before.setdefault(name, now)
        return now

    def lower(self, name: str, value: float) -> bool:
        """Set a limit unless it is as low already; return whether it was set."""
        now = self.remember(name)
        if number(now) <= value:
            self._ours[name] = now
            return False
        self._put(name, f"{value:.7g}")
        return True

    def set(self, name: str, value: float) -> None:
        """Set a value."""
        now = self.remember(name)
        if agrees(now, value):
            self._ours[name] = now
        else:
            self._put(name, as_said(now, value))

    def require(self) -> None:
        """Raise `HardwareError` where something is no longer as it was set."""
        for name, text in self._ours.items():
            now = self._protocol.get(self._prefix + name)
            if not agrees(now, number(text)):
                raise HardwareError(
                    f"{self._prefix}{name} is {now}, not {text} as it was set: the drive was reset "
                    "(look at its supply), or another program changes it"
                )

    def restore(self, feed: str) -> None:
        """Restore the original values, the last change first.

        `feed` feeds the watchdog: its owner's may start to count.
        """
        for name, text in reversed(self._before.items()):
            if not agrees(self._protocol.get(self._prefix + name), number(text)):
                self._protocol.put(self._prefix + name, text, commands=[feed])
        self._before.clear()

    def _put(self, name: str, text: str) -> None:
        self._protocol.put(self._prefix + name, text)
        self._ours[name] = text


def as_said(now: str, value: float) -> str:
    """Return a value as text in the form of `now`: true or false, or a number."""
    if now.lower() in ("true", "false"):
        return "true" if value else "false"
    return f"{value:.7g}"
