"""Whatever fails, the motor is off within the watchdog: each drive that is not older than CAN here.

The host is killed or stopped, the cable is pulled, either direction falls silent, or others fill
the line while the drive's answers are lost.
"""

import contextlib
import re
import struct

import pytest

from rigtool.errors import HardwareError
from rigtool.rigs import Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import open_serial_rig
from rigtool.rigs.serial.transport.can_frames import CanFrame, encode
from rigtool.rigs.serial.transport.spy import Spy
from tests.rigs.serial.emulators.faults import Fault, inject, serve
from tests.rigs.serial.emulators.vesc import framed
from tests.rigs.serial.recipes import serial_recipe
from tests.rigs.serial.test_commands import DRIVES

WATCHDOG = 0.25
LOOKS = 0.02
"""How late a drive may look at its watchdog, s: a VESC each 10 ms, emulated time each tick."""

ENDLESS = Task(SpeedProfile((0.0, 0.1, 60.0), (0.0, 6.0, 6.0)))
OTHERS = {"vesc": framed(struct.pack(">Bi", 22, 12345)), "simplefoc": b"0.1000\t0.2000\t3.0000\r\n"}
"""What else may come on a line; on a bus, the heartbeat of another node."""
FAILURES = ("killed", "stopped", "pulled", "deaf", "mute", "flooded")


def is_on(name, device):
    if name == "odrive-can":
        return device.state == 8
    if name == "moteus-can":
        return device.device.mode == 10
    return device.mode is not None


def rig_of(name, port, *limits):
    _, _, form, _ = DRIVES[name]
    more = {
        "odrive-can": ("serial.drive_torque_constant=0.045",),
        "simplefoc": ("serial.emergency_stop=true",),
    }.get(name, ())
    loop = {"crossover_hz": 2, "lead_ratio": 4, "integrator_hz": 0.1, "lowpass_hz": 25}
    more = (*more, *(f"rig.controller.{key}={value}" for key, value in loop.items()))
    recipe = serial_recipe(form.format(port), *more, *limits, driver=name, sample_time=0.01)
    operator = Operator(say=lambda text: None, present=False, yes=True)
    return open_serial_rig(recipe, 0.045, "test", operator)


def talk(device, data):
    """Let others send this on the line all the time; the device's own answers are lost."""
    receive, idle = device.receive, device.idle

    def lost(data):
        receive(data)
        return b""

    def others():
        idle()
        return data

    device.receive, device.idle = lost, others


def fail(failure, name, world, server, rig):
    """Let something fail from now on."""
    if failure == "killed":
        rig.line.close()
    elif failure == "stopped":
        rig.line.sleep_until = lambda moment: world.sleep(2.0)
    elif failure == "pulled":
        inject(server, Fault("pull", towards="device"))
    elif failure == "deaf":
        inject(server, Fault("silence", towards="device"))
    elif failure == "mute":
        inject(server, Fault("silence"))
    else:
        heartbeat = encode(CanFrame(0x705, b"\5"))
        talk(server.emulator, OTHERS.get(name, heartbeat))


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("name", DRIVES)
def test_motor_is_off_within_the_watchdog(world, name, failure):
    """Counted from the last bytes that reach the drive; a drive that hears may go on longer."""
    device = DRIVES[name][0]()
    world.tick = 0.005
    heard, receive = [], device.receive

    def hearing(data):
        if data:
            heard.append(world.now)
        return receive(data)

    device.receive = hearing
    with serve(device) as server, contextlib.ExitStack() as stack:
        rig = stack.enter_context(rig_of(name, server.port))
        running = rig.perform(ENDLESS)
        next(running)
        assert is_on(name, device)
        fail(failure, name, world, server, rig)
        begin = world.now
        while is_on(name, device):
            assert world.now < begin + 2.0
            world.sleep(0.002)
            device.idle()
        assert world.now - max(begin, heard[-1]) < WATCHDOG + LOOKS
        with pytest.raises(HardwareError):
            list(running)
        with contextlib.suppress(HardwareError):  # the drive is out of reach
            stack.close()
    assert server.error is None or failure == "pulled"
    assert not is_on(name, device)


@pytest.mark.parametrize("name", DRIVES)
def test_shaft_that_runs_away_is_no_faster_than_was_stated(world, name):
    """The motor turns against its current, which every loop takes for more and more error."""
    device = DRIVES[name][0]()
    world.tick = 0.005
    motor, top = getattr(device, "device", device).motor, 0.0
    step = motor._step

    def watching(*what):
        nonlocal top
        step(*what)
        top = max(top, abs(motor.speed))

    motor._step = watching
    limits = ("serial.limits.speed=20", "serial.limits.current=1")
    with serve(device) as server, rig_of(name, server.port, *limits) as rig:
        (note,) = [note for note in rig.notes if "runs away" in note]
        motor.torque_constant *= -1
        with pytest.raises(HardwareError):
            list(rig.perform(ENDLESS))
        assert not is_on(name, device)
    stated = float(re.search(r"at up to (\S+) rad/s", note)[1])
    print(name, top, note)
    assert top < stated


@pytest.mark.parametrize("name", DRIVES)
def test_a_log_on_a_full_disk_disturbs_no_motion_and_no_stop(world, name, tmp_path, caplog):
    device = DRIVES[name][0]()
    world.tick = 0.005
    motion = Task(SpeedProfile((0.0, 0.1, 0.5), (0.0, 3.0, 0.0)))
    with serve(device) as server, rig_of(name, server.port) as rig:
        spy = rig.line._spy = Spy(tmp_path / "line.spy", name)
        running = rig.perform(motion)
        next(running)
        spy._file.close()
        spy._file = open("/dev/full", "w", buffering=1)  # noqa: SIM115
        list(running)
        assert not is_on(name, device)
        assert is_moving_again(rig, device, name, motion)
    assert not is_on(name, device)
    spy.close()
    (warning,) = [record.getMessage() for record in caplog.records]
    assert "line.spy: ends here" in warning
    assert "the disk is full" in warning


def is_moving_again(rig, device, name, motion):
    """Break a motion off in the middle: what stops it goes over the line of the full log."""
    running = rig.perform(motion)
    next(running)
    on = is_on(name, device)
    running.close()
    return on and not is_on(name, device)
