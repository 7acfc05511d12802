"""A machine that refuses: limits, full streams, folders that go, several signals in a row."""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from rigtool.errors import RigtoolError
from tests.attack.bench import ANALYSES, Bench, inputs, measuring
from tests.attack.trial import CODES, Strike, Trial, content, run

Before = Callable[[], None]


def _limit(name: str, value: int) -> Before:
    number = getattr(resource, f"RLIMIT_{name}")
    return lambda: resource.setrlimit(number, (value, value))


def _full(*streams: int) -> Before:
    def fill() -> None:
        full = os.open("/dev/full", os.O_WRONLY)
        for stream in streams:
            os.dup2(full, stream)

    return fill


def _away() -> None:
    """Work in a folder that is gone."""
    folder = tempfile.mkdtemp()
    os.chdir(folder)
    os.rmdir(folder)


def _before(luck: random.Random) -> Before:
    """Return what is done to the process before its command begins."""
    return luck.choice(
        [
            _limit("FSIZE", int(10 ** luck.uniform(3, 6.5))),
            _limit("NOFILE", luck.randint(6, 24)),
            _full(*luck.choice([(1,), (2,), (1, 2)])),
            _away,
            lambda: os.umask(0o777) and None,
        ]
    )


def _strike(luck: random.Random, folder: Path) -> Strike:
    """Return what is done while the command runs."""
    pause = luck.uniform(0, 0.5)
    numbers = luck.choices([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], k=luck.choice([2, 10]))
    goes = luck.random() < 0.4

    def strike(process: int) -> None:
        time.sleep(pause)
        if goes:
            with suppress(FileNotFoundError):
                shutil.rmtree(folder)
            return
        for number in numbers:
            with suppress(ProcessLookupError):
                os.kill(process, number)
            time.sleep(0.001)

    return strike


def _lines(bench: Bench, folder: Path) -> list[list[object]]:
    name = bench.luck.choice(list(ANALYSES))
    run_file, command = bench.stored[name], ANALYSES[name]
    return [
        measuring(bench.luck.choice(["calibrate-kt", "suspension", "fft-ripple"]), folder / "o.h5"),
        [command, run_file, *inputs(command), "-o", folder / "o.h5", "--overwrite"],
        ["export", run_file, "-o", folder / "o.mat", "--overwrite"],
        ["report", bench.stored["kt"], "-o", folder / "report", "--overwrite"],
        ["info", run_file, "--json"],
    ]


def refusing(bench: Bench) -> Trial:
    """A command that the machine refuses something ends in order: no half-written, lost file."""
    folder = bench.file("in") / "out"
    folder.mkdir(parents=True)
    line = bench.luck.choice(_lines(bench, folder))
    shutil.copyfile(bench.stored["kt"], folder / "o.h5")
    earlier = content(folder / "o.h5")
    struck = bench.luck.random() < 0.4
    found = run(
        line,
        _strike(bench.luck, folder) if struck else None,
        frozenset({*CODES, 129, 130, 143} if struck else CODES),
        None if struck else _before(bench.luck),
    )
    faults = list(found.faults)
    if folder.exists():
        if any(name.startswith(".rigtool") for name in os.listdir(folder)):
            faults.append("left over")
        try:
            now = content(folder / "o.h5")
            if found.code != 0 and now not in (None, earlier):
                run(line)  # where only the message had no room, the output is there, whole
                if content(folder / "o.h5") != now:
                    faults.append("half written")
        except RigtoolError:
            faults.append("damaged")
    return replace(found, faults=tuple(faults))
