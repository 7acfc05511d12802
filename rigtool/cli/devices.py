"""`rigtool devices`: serial ports and the devices that answer on them."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, echo, example, json_option


@click.command(epilog=example("rigtool devices", "rigtool devices /dev/ttyACM0 --json"))
@click.argument("ports", metavar="[PORT]...", nargs=-1)
@click.option("--driver", "drivers", multiple=True, help="Query for this kind of device only.")
@json_option
@debug_option
def command(ports: tuple[str, ...], drivers: tuple[str, ...], as_json: bool) -> None:
    """List serial ports and the devices that answer on them.

    Queries all ports of this computer, or those given (any URL of pyserial). Nothing moves and no
    setting changes. A device that takes every byte for a command may be disturbed by queries for
    other devices: name the driver of its port then.
    """
    import json
    from dataclasses import asdict

    from rigtool.errors import HardwareError, UsageError
    from rigtool.rigs.serial.ports import askable, find_devices

    for name in drivers:
        if name not in askable():
            raise UsageError(f"--driver {name}: there is none; use one of {', '.join(askable())}")
    found = []
    for device in find_devices(ports, drivers):
        found.append(device)
        if not as_json:
            answer = f"{device.driver}: {device.identity}" if device.driver else device.problem
            about = f" ({device.description})" if device.description else ""
            echo(f"{device.port}{about}: {answer or 'nothing answers'}")
    if as_json:
        echo(json.dumps([asdict(device) for device in found], indent=2))
    elif not found:
        echo("no serial ports on this computer", err=True)
    if closed := [device.port for device in found if device.problem and ports]:
        raise HardwareError(f"{', '.join(closed)}: cannot be asked")
