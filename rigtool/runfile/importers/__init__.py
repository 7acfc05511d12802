"""Imports of files of other programs: text, MATLAB, NumPy, EPOS Studio.

A mapping (recipes/import/*.toml, `rigtool.recipe.mapping`) states the meaning of the columns. A bad
file is refused with line and remedy, and nothing is written. docs/run-file-format.md, 'Imported
runs', describes the output.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from collections.abc import Mapping as MappingType
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from rigtool.errors import RigtoolError, RunFileError, UsageError
from rigtool.plugins import load_all, warn
from rigtool.quantity import Quantity
from rigtool.recipe.mapping import Mapping
from rigtool.runfile import schema
from rigtool.runfile.importers import epos
from rigtool.runfile.importers.arrays import read_arrays
from rigtool.runfile.importers.conditions import unchanged_parts
from rigtool.runfile.importers.contradictions import contradictions
from rigtool.runfile.importers.convert import (
    intervals,
    irregular,
    longest,
    stem,
    to_si,
    whole_times,
)
from rigtool.runfile.importers.counters import with_shown_ends
from rigtool.runfile.importers.maps import read_map
from rigtool.runfile.importers.one_axis import on_one_axis
from rigtool.runfile.importers.plan import is_binary, plan
from rigtool.runfile.importers.raw import Array, Importer, Raw
from rigtool.runfile.importers.text import read_text
from rigtool.runfile.model import Channel, RecordingSpec
from rigtool.runfile.outputs import own_folder, require_output, require_place
from rigtool.runfile.provenance import Source, file_sha256
from rigtool.runfile.writer import RunWriter
from rigtool.signals import SIGNALS

IMPORTERS = {"epos": epos.IMPORTER}
"""Formats that are recognised without a mapping, in the order in which they are tried."""

IMPORTER_ENTRY_POINTS = "rigtool.importers"
"""Group of the entry points with which other packages add formats: each an `Importer`."""

LIKENESS = 0.8
"""Similarity (`difflib`) from which on a name may be a slip."""

LINES_NAMED = 5
"""Most bad lines that a note names."""


@dataclass(frozen=True)
class Imported:
    """The import of one source file: `samples` read, bad lines `left_out`, `notes`."""

    source: Path
    output: Path
    samples: int
    left_out: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Import:
    """What was imported, and the files that were left out: by their names, and bad ones."""

    done: list[Imported]
    of_other_names: list[Path]
    bad: dict[Path, RunFileError]


def import_files(
    sources: Sequence[str],
    output: str,
    mapping: tuple[Mapping, str] | None,
    *,
    skip_bad: bool = False,
    skip_bad_files: bool = False,
    overwrite: bool = False,
    map_path: str | None = None,
) -> Import:
    """Make a run file of one source file, or a folder of run files of a folder or several files.

    `mapping` comes with its text, from `map_path`; no output replaces that or a source. If one file
    cannot be imported, no file is written; with `skip_bad_files` the others are. Raises
    `UsageError` for names that do not go together, `RunFileError` for all bad sources at once.
    """
    read = [Path(source) for source in sources] + ([] if map_path is None else [Path(map_path)])
    endings = [ending for importer in importers().values() for ending in importer.endings]
    pattern = None if mapping is None else mapping[0].files
    planned = plan(sources, Path(output), overwrite, endings, pattern)
    names = planned.names
    if not planned.is_folder:
        (source,) = names
        final = require_output(output, overwrite=overwrite, inputs=read)
        done = [_import_file(source, final, Path(output), mapping, skip_bad, overwrite)]
        return Import(done, planned.left_out, {})
    folder = Path(output)
    done, bad = [], {}
    with _new_folders() as make_folder:
        make_folder(folder)
        with own_folder(folder) as beside:
            for source, name in names.items():
                here, final = beside / "runs" / name, folder / name
                here.parent.mkdir(parents=True, exist_ok=True)
                if here.exists():
                    raise UsageError(
                        f"{source}: its run {final} is that of another file, since names differ in "
                        "case or accents only, which is one name on this disk: rename the file"
                    )
                try:
                    done.append(_import_file(source, here, final, mapping, skip_bad, overwrite))
                except RunFileError as error:
                    bad[source] = error
            if bad and not (skip_bad_files and done):
                raise _all_bad(bad, len(names))
            for item in done:
                make_folder(item.output.parent)
                require_output(item.output, overwrite=overwrite, inputs=[*names, *read])
            for item in done:
                os.replace(beside / "runs" / names[item.source], item.output)
    return Import(done, planned.left_out, bad)


def _all_bad(bad: MappingType[Path, RunFileError], count: int) -> RunFileError:
    """Return one error for all bad files, each with its first bad line."""
    if len(bad) == count == 1:
        return next(iter(bad.values()))
    head = f"{len(bad)} of {count} files cannot be imported:"
    remedy = (
        'correct them, state in the mapping which files it is for (files = "*.csv"), or go on '
        "without them by --skip-bad-files"
        if len(bad) < count
        else "correct the files or the mapping; --skip-bad-lines leaves bad lines out"
    )
    paths: dict[str, list[str]] = {}  # of each reason
    for path, error in bad.items():
        reason = first_of(error).removeprefix(str(path))
        paths.setdefault(reason if reason.startswith(":") else first_of(error), []).append(
            str(path)
        )
    lines = [
        f"  {', '.join(named)}{reason}" if reason.startswith(":") else f"  {reason}"
        for reason, named in paths.items()
    ]
    return RunFileError("\n".join([head, *lines, remedy]))


def first_of(error: RunFileError) -> str:
    """Return what an error on a file states first: of bad lines the first one."""
    lines = str(error).splitlines()
    return lines[1].strip() if len(lines) > 1 else lines[0]


def importers() -> dict[str, Importer]:
    """Return the formats that are recognised without a mapping, those of other packages last."""
    return IMPORTERS | load_all(IMPORTER_ENTRY_POINTS, Importer, frozenset(IMPORTERS))


@contextmanager
def _new_folders() -> Iterator[Callable[[Path], None]]:
    """Give a function that makes a folder and those above; after an error they go again."""
    made: list[Path] = []

    def make(folder: Path) -> None:
        if not folder.exists():
            make(folder.parent)
            require_place(folder, Path(os.path.abspath(folder)))
            folder.mkdir()
            made.append(folder)

    try:
        yield make
    except BaseException:
        for folder in reversed(made):
            with suppress(OSError):  # another program may have put a file there
                folder.rmdir()
        raise


def _import_file(
    source: Path,
    here: Path,
    final: Path,
    mapping: tuple[Mapping, str] | None,
    skip_bad: bool,
    overwrite: bool,
) -> Imported:
    """Read one file and write its run to `here`."""
    known, text = (None, None) if mapping is None else mapping
    origin = Source(str(source), file_sha256(source), text)
    if known is not None and known.map is not None:
        return _import_map(source, here, final, known, origin, overwrite)
    signals, raw, known, notes = understand(source, known, skip_bad)
    found, missing = unchanged_parts(source, raw, known)
    channels = _channels(signals, known)
    several = [f"{schema.IMPORTED}_{number:03d}" for number in range(len(found))]
    names = [schema.IMPORTED] if len(found) == 1 else several
    specs = [
        RecordingSpec(name, channels, part.conditions)
        for name, part in zip(names, found, strict=True)
    ]
    notes = [*notes, *missing]
    with RunWriter(
        here,
        command=schema.IMPORT,
        recordings=specs,
        overwrite=overwrite,
        rig=known.rig.name,
        source=origin,
    ) as writer:
        for spec, part in zip(specs, found, strict=True):
            samples = slice(part.start, part.stop)
            writer.append(spec.name, {name: values[samples] for name, values in signals.items()})
        writer.finish(_results(len(raw.left_out)), {}, notes)
    return Imported(source, final, len(raw.line), len(raw.left_out), tuple(notes))


def understand(
    source: Path, mapping: Mapping | None, skip_bad: bool
) -> tuple[dict[str, Array], Raw, Mapping, list[str]]:
    """Return the signals of a file in SI, what they come from, the mapping with them, and notes.

    Raises `RunFileError` for a bad file.
    """
    raw, known, notes = _read(source, mapping, skip_bad)
    raw = whole_times(raw, known)
    known, ends = with_shown_ends(raw, known)
    raw, filled = on_one_axis(source, raw, known)
    signals, raw = to_si(source, raw, known, skip_bad)
    uneven = irregular(intervals(signals["time"], raw))
    notes += [note for note in (*ends, *filled, uneven, _left_out_note(raw)) if note]
    notes += [*contradictions(longest(signals, raw), known), *_slips(known)]
    return signals, raw, known, notes


def _slips(mapping: Mapping) -> list[str]:
    """Return notes on names of signals that resemble one with a fixed meaning."""
    free = [name for name in SIGNALS if name not in mapping.signals]
    found = {
        name: get_close_matches(name, free, 1, LIKENESS)
        for name in mapping.signals
        if name not in SIGNALS
    }
    return [
        f"signal {name} has no fixed meaning: if it is {near[0]}, call it that"
        for name, near in found.items()
        if near and not name.startswith(near[0])
    ]


def _read(source: Path, mapping: Mapping | None, skip_bad: bool) -> tuple[Raw, Mapping, list[str]]:
    """Return columns, the mapping with signals, and notes."""
    if (known := recognised(source)) is not None:
        name, importer = known
        bare = Mapping(mapping=1, rig={"name": stem(source)})
        try:
            return importer.read(source, mapping or bare, skip_bad)
        except RigtoolError:
            raise
        except Exception as error:  # an importer of anybody's may raise anything
            raise RunFileError(
                f"{source}: importer {name} fails at it: {type(error).__name__}: {error}"
            ) from error
    if mapping is None or not mapping.signals:
        if source.suffix == ".h5":
            raise RunFileError(
                f"{source}: ends in .h5, as run files do, which need no import: `rigtool info` "
                "shows one; for another file of HDF5 give --map"
            )
        raise RunFileError(
            f"{source}: does not state the meaning of its columns: give --map with a mapping file "
            "that has [signals]; --preview shows one to fill in"
        )
    if is_binary(source):
        return read_arrays(source, mapping.file.variable, mapping.columns, skip_bad), mapping, []
    raw, notes = read_text(source, mapping, skip_bad)
    return raw, mapping, notes


def recognised(source: Path) -> tuple[str, Importer] | None:
    """Return name and importer of the format that a file is recognised as, None where it is not.

    An importer that fails does not know the file.
    """
    for name, importer in importers().items():
        try:
            if importer.recognises(source):
                return name, importer
        except Exception as error:  # an importer of anybody's may raise anything
            warn(f"importer {name} fails at {source}: {type(error).__name__}: {error}")
    return None


def _channels(signals: MappingType[str, Array], mapping: Mapping) -> tuple[Channel, ...]:
    channels = [Channel("time", "s", "f8", "clock of the recording")]
    for name in signals:
        if name != "time":
            channels.append(Channel(name, mapping.unit(name), "f8", mapping.description(name)))
    return tuple(channels)


def _results(left_out: int) -> dict[str, Quantity]:
    return {"lines_left_out": Quantity(float(left_out), "1", reason="a count")}


def _left_out_note(raw: Raw) -> str | None:
    if not raw.left_out:
        return None
    numbers = sorted(raw.left_out)
    listed = "; ".join(
        f"{raw.what} {number}: {raw.left_out[number]}" for number in numbers[:LINES_NAMED]
    )
    more = f"; and {len(numbers) - LINES_NAMED} more" if len(numbers) > LINES_NAMED else ""
    were = f"{raw.what} was" if len(numbers) == 1 else f"{raw.what}s were"
    return f"{len(numbers)} bad {were} left out: {listed}{more}"


def _import_map(
    source: Path, here: Path, final: Path, mapping: Mapping, origin: Source, overwrite: bool
) -> Imported:
    """Write a series around a turn as a table."""
    table, notes = read_map(source, mapping)
    with RunWriter(
        here, command=schema.IMPORT, overwrite=overwrite, rig=mapping.rig.name, source=origin
    ) as writer:
        writer.finish(_results(0), {schema.MAP: table}, notes)
    return Imported(source, final, table.shape[0], 0, tuple(notes))
