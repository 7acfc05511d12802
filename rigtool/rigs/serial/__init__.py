"""Rigs at the end of a serial line.

Responsibilities
-------------
`line.Line` moves bytes: deadlines, repeated requests, counts, spy file, replay. `rig.SerialRig` is
common to all serial rigs: limits, permission, operator, instruments, switching off. A drive that
takes set points one by one is a `drive.Drive`, and `hosted.rig.HostedRig` runs motions on it from
the host. The `target` runs whole motions by itself and has a rig of its own.

Writing a driver
----------------
A driver is a `drivers.Driver`, found in a module of `drivers.DRIVER_MODULES` or by an entry point;
its `make_drive` returns a `drive.Drive`. The order of calls is

    connect, abilities, configure            nothing moves; `read` at any time from here on
    enable(mode), step, step, ..., halt      once for each motion
    halt, restore                            always at the end, after errors as well, then the line
                                             is closed; `halt` may come at any time, also twice

Rules:
- Speak through the `Line` only. `Line.ask` for lines of text, `Line.exchange` with a function that
  reads one reply for everything else. Both repeat a request that may be repeated (`retries=0` for
  one that may not) and count it. Raise `DamagedReply` where a checksum, length or form is wrong,
  return None from `accept` where a line answers an older question. `LineLost` is raised for you.
- Raise `HardwareError` where the drive refuses or reports an error: value, limit, remedy.
- Times that enter a sample or a command come from `Line.now()`, never from `time`: a spy file then
  plays back exactly. Nothing else may call `Line.now()`, and no random number enters a request.
  An instrument has a line of its own beside the drive's, with the same clock and spy file.
- `step` should be a single exchange where the protocol allows it: that sets the rate.
- SI at the interface: rad and rad/s of the motor shaft, A, degC. Feed-forward comes as current: a
  drive that takes torque multiplies it by its own torque constant (read from the drive in
  `connect`), so that this current flows.
- `configure` remembers each value before changing it; `restore` restores these values and no
  others; nothing is stored in the drive's flash. Limits are set as low as asked, the watchdog to
  `watchdog` s. Limits that the drive cannot watch are returned in words.
- `halt` works from any state and tries more than once by itself; afterwards no current flows.

Emulators and tests
-------------------
A subclass of `emulators.server.Emulator` is a device: bytes in, bytes out, with the known faults of
the real one. `emulators.server.serve(emulator)` puts it on a pseudo-terminal; a recipe or `Line`
opens its `port`. `emulators.motor.EmulatedMotor` is a shaft with inertia and friction.
`tests/rigs/serial/emulators/` of a checkout holds devices of rigtool's own drivers, and in `faults`
what goes wrong on a line, and when: flipped bits, lost, doubled or cut bytes, silence, reset,
refusal, a pulled cable, a reply to an older question.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rigtool.recipe import Recipe
    from rigtool.rigs.operator import Operator
    from rigtool.rigs.serial.rig import SerialRig


def open_serial_rig(
    recipe: Recipe, torque_constant: float, use: str, operator: Operator
) -> SerialRig:
    """Return the rig of a recipe's [serial], not connected yet: use it as a context manager.

    Raises `RecipeError` for an unknown driver.
    """
    from rigtool.rigs.serial.drivers import driver
    from rigtool.rigs.serial.hosted.rig import HostedRig

    recipe = _as_recorded(recipe)
    found = driver(recipe.line.driver)
    if found.make_rig is not None:
        return found.make_rig(recipe, torque_constant, use, operator)
    return HostedRig(recipe, torque_constant, use, operator, found)


def _as_recorded(recipe: Recipe) -> Recipe:
    """Return a recipe whose driver is the one of the record, where it plays one back."""
    from rigtool.rigs.serial.drivers import REPLAY_DRIVER
    from rigtool.rigs.serial.transport.opening import REPLAY_PREFIX
    from rigtool.rigs.serial.transport.spy import read_spy

    if recipe.line.driver != REPLAY_DRIVER:
        return recipe
    path = recipe.line.port.removeprefix(REPLAY_PREFIX)
    recorded = {"driver": read_spy(path)[0], "port": f"{REPLAY_PREFIX}{path}"}
    return recipe.model_copy(update={"serial": recipe.line.model_copy(update=recorded)})
