"""`rigtool devices`: serial ports and the devices that answer on them."""

from __future__ import annotations

import click

from rigtool.cli.options import command_with, current_output


@command_with("rigtool devices", "rigtool devices --driver moteus --json")
@click.argument("ports", metavar="[PORT]...", nargs=-1)
@click.option("--driver", "drivers", multiple=True, help="Query for this kind of device only.")
def command(ports: tuple[str, ...], drivers: tuple[str, ...]) -> None:
    """List serial ports and the devices that answer on them.

    Queries all ports of this computer, or those given (any URL of pyserial). Nothing moves and no
    setting changes. A device that takes every byte for a command may be disturbed by queries for
    other devices: name the driver of its port then.
    """
    from dataclasses import asdict

    from rigtool.errors import HardwareError, UsageError, did_you_mean
    from rigtool.rigs.serial.ports import askable, find_devices

    for name in drivers:
        if name not in askable():
            remedy = did_you_mean(name, askable(), "use one of them")
            raise UsageError(
                f"--driver {name}: is not known, only {', '.join(askable())}; {remedy}"
            )
    found, output = [], current_output()
    for device in find_devices(ports, drivers):
        found.append(device)
        answer = f"{device.driver}: {device.identity}" if device.driver else device.problem
        about = f" ({device.description})" if device.description else ""
        output.line(f"{device.port}{about}: {answer or 'nothing answers'}")
    output.document(devices=[asdict(device) for device in found])
    if not found:
        output.note("no serial ports on this computer")
    if closed := [device.port for device in found if device.problem and ports]:
        raise HardwareError(f"{', '.join(closed)}: not queried, the reason is above")
