"""The checklist of a release: `make release-check`, after style, types, tests and the site.

Each item passes or states what is missing. Nothing is uploaded, tagged or changed; the built files
stay in build/dist. Exit code 1 where an item fails.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent
DIST = ROOT / "build" / "dist"
RELEASE = re.compile(r"^## (\S+) \((.+)\)$", re.MULTILINE)
"""A heading of CHANGELOG.md: version, and its date or "not released"."""


def main() -> int:
    """Run all checks and return the exit code."""
    failed = 0
    for check in (clean_tree, versions, dated, address, untagged, distributions, installed):
        faults = list(check())
        failed += bool(faults)
        print(f"{'FAIL' if faults else 'ok  '}  {check.__doc__}")
        for fault in faults:
            print(f"      {fault}")
    print("not ready" if failed else "ready: tag the commit, upload build/dist")
    return 1 if failed else 0


def project() -> dict:
    """Return the table `project` of pyproject.toml, the one place that states the version."""
    return tomllib.loads(read("pyproject.toml"))["project"]


def read(name: str) -> str:
    """Return the text of a file of the repository."""
    return (ROOT / name).read_text(encoding="utf-8")


def tracked() -> list[str]:
    """Return the files that git tracks."""
    return output("git", "ls-files").splitlines()


def output(*command: str, cwd: Path = ROOT) -> str:
    """Return what a command prints; end with its messages where it fails."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def clean_tree() -> Iterator[str]:
    """Everything is committed"""
    yield from output("git", "status", "--porcelain").splitlines()


def versions() -> Iterator[str]:
    """CHANGELOG.md and CITATION.cff state the version of pyproject.toml"""
    version = project()["version"]
    latest = RELEASE.search(read("CHANGELOG.md"))
    if latest is None or latest[1] != version:
        yield f"CHANGELOG.md: the first heading must be {version}"
    if f"\nversion: {version}\n" not in read("CITATION.cff"):
        yield f"CITATION.cff: version must be {version}"


def dated() -> Iterator[str]:
    """The release has a date, the same in CHANGELOG.md and CITATION.cff"""
    latest = RELEASE.search(read("CHANGELOG.md"))
    date = latest[2] if latest else ""
    if not re.fullmatch(r"\d{4}-\d{2}-\d{2}", date):
        yield f"CHANGELOG.md: {date!r} must be a date, YYYY-MM-DD"
    elif f"\ndate-released: {date}\n" not in read("CITATION.cff"):
        yield f"CITATION.cff: date-released must be {date}"


def address() -> Iterator[str]:
    """The package names its public repository"""
    if not project().get("urls", {}).get("Repository", "").startswith("https://"):
        yield "pyproject.toml: [project.urls] has no Repository; the description has no links"


def untagged() -> Iterator[str]:
    """The version was not released before"""
    tag = f"v{project()['version']}"
    if output("git", "tag", "--list", tag).strip():
        yield f"tag {tag} exists: raise the version in pyproject.toml"


def distributions() -> Iterator[str]:
    """The source distribution is complete, and so is the wheel that is built from it"""
    source, wheel = build(DIST)
    yield from faults_of(source, wheel)


def build(folder: Path) -> tuple[Path, Path]:
    """Build both distributions from a copy of the tracked files; return their paths."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as scratch:
        for name in tracked():
            if (ROOT / name).is_file():
                target = Path(scratch, name)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, target)
        _build("sdist", Path(scratch), folder)
    (source,) = folder.glob("*.tar.gz")
    with tempfile.TemporaryDirectory() as scratch:
        with tarfile.open(source) as archive:
            archive.extractall(scratch, filter="data")
        _build("wheel", next(Path(scratch).iterdir()), folder)
    (wheel,) = folder.glob("*.whl")
    return source, wheel


def _build(kind: str, project: Path, folder: Path) -> None:
    code = f"import setuptools.build_meta as b; b.build_{kind}({str(folder)!r})"
    output(sys.executable, "-c", code, cwd=project)


def faults_of(source: Path, wheel: Path) -> Iterator[str]:
    """Yield what is missing in the distributions, or wrong with them."""
    with tarfile.open(source) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    for name in tracked():
        if (ROOT / name).is_file() and name not in inside:
            yield f"{source.name}: has no {name}; see MANIFEST.in"
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        text = archive.read(metadata).decode()
    for name in ("rigtool/py.typed", "rigtool/report/published.toml"):
        if name not in names:
            yield f"{wheel.name}: has no {name}"
    if not any(name.endswith("share/rigtool/recipes/briaire-2006.toml") for name in names):
        yield f"{wheel.name}: has no recipes"
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if not target.startswith("https://"):
            yield f"{wheel.name}: its description links to {target}"


def installed() -> Iterator[str]:
    """The wheel measures in an empty environment"""
    (wheel,) = DIST.glob("*.whl")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        venv.create(folder / "env", with_pip=True)
        programs = folder / "env" / ("Scripts" if sys.platform == "win32" else "bin")
        output(str(programs / "python"), "-m", "pip", "install", "--quiet", str(wheel), cwd=folder)
        rigtool = str(programs / "rigtool")
        version = output(rigtool, "--version", cwd=folder)
        if project()["version"] not in version:
            yield f"rigtool --version shows {version.strip()}"
        short = ("--set", "calibrate_kt.temperatures_degc=[20, 50]")
        output(rigtool, "recipe", "briaire-2006", "-o", "rig.toml", cwd=folder)
        output(rigtool, "calibrate-kt", "rig.toml", "-o", "kt.h5", *short, cwd=folder)
        output(rigtool, "report", "kt.h5", "-o", "report", cwd=folder)
        if not (folder / "report" / "index.html").is_file():
            yield "rigtool report wrote no report/index.html"


if __name__ == "__main__":
    sys.exit(main())
