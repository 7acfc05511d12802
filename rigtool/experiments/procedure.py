"""A measuring command as a value: its recordings, the motions of the rig, the analysis of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field

from rigtool.errors import UsageError
from rigtool.experiments.outcome import Outcome
from rigtool.recipe import Recipe
from rigtool.rigs import Block, Rig, Task
from rigtool.runfile import Channel, RecordingSpec, Run, RunWriter
from rigtool.signals import CHANNELS


@dataclass(frozen=True, eq=False)
class Procedure:
    """Everything that `session.run_command` has to know about a command; inputs are open runs.

    `recordings(recipe)` lists the recordings; `measure(rig, recipe, recorder, **inputs)`
    performs the tasks and records them; `analyse(runs, recipe, **inputs)` computes results from
    stored signals only. `needed` names the inputs that only imported runs can do without.

    A procedure with `bare_motor` measures without the instrument, even where the recipe has one:
    motor and amplifier are characterised on their own [7.1, 7.2]. `accepts` names other commands
    whose stored runs it analyses. `analyse_imported(runs, **inputs)` takes runs of other rigs;
    `imported_settings` maps the keys of `--set` that it takes to its argument names.

    `follow(recipe, **inputs)` returns what turns blocks of signals, as they come, into the values
    that are shown instead of them: arrays by name, `time` among them.

    `rig_needs(recipe)` names the abilities for motions that depend on results measured
    first, see `dry_run`.

    `analysis_settings` are the keys of the recipe that decide how stored signals are read, and that
    changed no motion: a stored run may be analysed with other values of these only.
    """

    command: str
    recordings: Callable[[Recipe], tuple[RecordingSpec, ...]]
    measure: Callable[..., None]
    analyse: Callable[..., Outcome]
    needed: tuple[str, ...] = ()
    bare_motor: bool = False
    accepts: tuple[str, ...] = ()
    analyse_imported: Callable[..., Outcome] | None = None
    imported_settings: Mapping[str, str] = field(default_factory=dict)
    follow: Callable[..., Callable[[Block], Block]] | None = None
    rig_needs: Callable[[Recipe], tuple[str, ...]] = lambda recipe: ()
    analysis_settings: tuple[str, ...] = ()


def channels(*names: str) -> tuple[Channel, ...]:
    """Return the channels of these names as run files describe them."""
    return tuple(Channel(name, *CHANNELS[name]) for name in names)


def only_run(runs: Sequence[Run], command: str, what: str) -> Run:
    """Return the one run that a command takes, with all of `what`; `UsageError` for more."""
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} run files: {command} takes one, with all its {what}")
    return runs[0]


def record(
    rig: Rig,
    task: Task,
    recorder: RunWriter,
    recording: str,
    watch: Callable[[Block], None] | None = None,
) -> None:
    """Perform a task and stream its signals into a recording.

    `watch` gets each block once it is recorded, and ends the measurement where it raises an error.
    """
    names = recorder.channel_names(recording)
    with closing(rig.perform(task)) as blocks:
        for block in blocks:
            recorder.append(recording, {name: block[name] for name in names})
            if watch is not None:
                watch(block)
