"""The lowest versions that pyproject.toml declares, as requirements of pip: `make test-lowest`."""

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def lowest() -> list[str]:
    """Return what the package needs and its extra for tables, each at its lowest version."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["parquet"]]
    return [re.sub(">=", "==", requirement) for requirement in needed]


if __name__ == "__main__":
    print("\n".join(lowest()))
