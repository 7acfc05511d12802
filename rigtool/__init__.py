"""rigtool turns a motor, an encoder and a current amplifier into a force sensor.

In Python, `rigtool.open` and the functions named after the commands do the same as the commands,
see docs/python.md. Everything is imported when it is first used.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rigtool.api import (
        Outcome,
        Quantity,
        RigtoolError,
        Run,
        calibrate_kt,
        fft_ripple,
        identify_plant,
        ilc_learn,
        measure_force,
        open,
        stribeck,
    )

__all__ = [
    "Outcome",
    "Quantity",
    "RigtoolError",
    "Run",
    "__version__",
    "calibrate_kt",
    "fft_ripple",
    "identify_plant",
    "ilc_learn",
    "measure_force",
    "open",
    "stribeck",
]


def __getattr__(name: str) -> object:
    # Metadata and numerics are read on demand: `rigtool --help` does not need them.
    if name == "__version__":
        from importlib.metadata import version

        return version("rigtool")
    if name in __all__:
        from rigtool import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
