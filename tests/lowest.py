"""The lowest versions that pyproject.toml declares, as requirements of pip: `make test-lowest`."""

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def lowest() -> list[str]:
    """Return what the package and its extras need, each at its lowest version."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *extras["parquet"], *extras["can"], *extras["visa"]]
    return [re.sub(">=", "==", requirement) for requirement in needed]


if __name__ == "__main__":
    print("\n".join(lowest()))
