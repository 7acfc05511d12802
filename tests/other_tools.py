"""Other programs whose output tests compare with, imported by the tests that use them."""

from importlib import import_module
from typing import Any


class Later:
    """A module that is imported where one of its names is first used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # pytest asks all that is in a module for marks of its own
            raise AttributeError(name)
        return getattr(import_module(self._name), name)


control = Later("control")
"""python-control, which draws with pyplot: more than a second at each start of the tests."""
