"""`rigtool target-emulator`: the virtual rig behind the host-target link."""

from __future__ import annotations

import click

from rigtool.cli.options import (
    FILE_ARGUMENT,
    Integer,
    Number,
    command_with,
    current_output,
    set_option,
)


@command_with("rigtool target-emulator rig.toml --tcp 127.0.0.1:0 --for 0.5")
@click.argument("recipe", type=FILE_ARGUMENT, metavar="RECIPE.toml")
@click.option(
    "--tcp", metavar="HOST:PORT", help="Serve at this address instead of a pseudo-terminal."
)
@click.option("--paced", is_flag=True, help="Simulate in real time; default: as fast as possible.")
@click.option("--forgetful", is_flag=True, help="Discard samples once they are streamed.")
@click.option("--for", "seconds", type=Number(min=0), help="End after this many seconds.")
@click.option("--channels", metavar="NAME,...", help="Record these channels only, and time.")
@click.option("--seed", type=Integer(min=0), help="Seed of the virtual rig.")
@set_option
def command(
    recipe: str,
    tcp: str | None,
    paced: bool,
    forgetful: bool,
    seconds: float | None,
    channels: str | None,
    seed: int | None,
    overrides: tuple[str, ...],
) -> None:
    """Serve a recipe's virtual rig over the host-target link.

    Prints the port to write into a recipe (serial.port), and serves until Ctrl-C. For trying out
    recipes without hardware, and as a pattern for firmware: target-link.md.
    """
    from rigtool.recipe import load_recipe
    from rigtool.rigs.serial.emulators.server import PtyServer, Server, TcpServer
    from rigtool.rigs.serial.emulators.target import TargetEmulator

    more = () if seed is None else (f"virtual.seed={seed}",)
    emulator = TargetEmulator(
        load_recipe(recipe, (*overrides, *more))[0],
        paced=paced,
        keeps_log=not forgetful,
        channels=None if channels is None else ("time", *channels.split(",")),
    )
    server: Server = PtyServer(emulator) if tcp is None else TcpServer(emulator, address=tcp)
    server.start()
    output = current_output()
    output.line(server.port)
    output.document(port=server.port)
    try:
        server.wait(seconds)
    finally:
        server.stop()
