"""`rigtool config`: the defaults that hold in this folder."""

from __future__ import annotations

from rigtool.cli.options import command_with, current_output


@command_with("rigtool config --json")
def command() -> None:
    """Show the defaults that rigtool.toml states for this folder.

    \b
    recipe = "rig.toml"        SOURCE of the commands that measure
    kt = "runs/kt.h5"          --kt, and the output of calibrate-kt
    tables = "runs/tables.h5"  --tables, and the output of ilc-learn
    output = "runs"            folder of all other outputs, COMMAND.h5

    Names are relative to this folder. An option on the command line takes precedence.
    """
    from pathlib import Path

    from rigtool.cli.defaults import DEFAULT_KEYS, DEFAULTS_FILE, stated

    found, to = stated(), current_output()
    file = Path.cwd() / DEFAULTS_FILE
    to.document(file=str(file) if file.exists() else None, defaults=found)
    count = f"{len(found)} default{'s' * (len(found) != 1)}"
    to.note(f"{file}: {'' if file.exists() else 'no such file: '}{count}")
    for key, meaning in DEFAULT_KEYS.items():
        to.line(f"{key:7} {found.get(key, 'none'):24} {meaning}")
