"""rigtool turns a motor, an encoder and a current amplifier into a force sensor."""

from importlib.metadata import version

__all__ = ["__version__"]


def __getattr__(name: str) -> str:
    # The package's metadata is only read when somebody asks: `rigtool --help` does not.
    if name == "__version__":
        return version("rigtool")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
