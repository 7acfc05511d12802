"""The description of the package: README.md with links that hold outside the repository."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
FIGURE = re.compile(r"!\[[^\]]*\]\([^)\s]+\)\n\n\*[^*]+\*\n\n")
LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")


def description() -> str:
    """Return README.md with absolute links.

    Links point at the tag of this version in the repository named in `[project.urls]`. Without
    such an entry a link becomes its text, and an image is left out with its caption.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    repository = project.get("urls", {}).get("Repository")

    def absolute(link: re.Match[str]) -> str:
        if "://" in link["target"]:
            return link[0]
        if repository is None:
            return "" if link["image"] else link["text"]
        kind = "raw" if link["image"] else "blob"
        target = f"{repository}/{kind}/v{project['version']}/{link['target']}"
        return f"{link['image']}[{link['text']}]({target})"

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return LINK.sub(absolute, text if repository else FIGURE.sub("", text))


setup(long_description=description(), long_description_content_type="text/markdown")
