"""A drive that exists nowhere, with the simplest protocol that has all a driver needs.

Lines of text: `m` measures, `s MODE POSITION SPEED CURRENT` sets and measures, `e MODE` enables,
`h` halts, `l VALUE` sets the limit of current, `w SECONDS` the watchdog, `i` identifies. Each line
ends with a checksum, the sum of all bytes; a request with a wrong one is answered `what?`.
"""

import time

from rigtool.errors import HardwareError
from rigtool.rigs.serial.drive import Abilities, Sample, SetPoint
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.line import DamagedReply


def make_drive(line, recipe):
    return ToyDrive(line)


def probe(line):
    return line.ask(sealed("i"), lambda text: text.decode() if text.startswith(b"toy") else None)


DRIVER = Driver(probe, (115200,), make_drive)


def sealed(text):
    return f"{text} {sum(text.encode()) % 256}\n".encode()


class ToyEmulator(Emulator):
    def __init__(self, watchdog_works=True):
        self.motor = EmulatedMotor()
        self.log = []
        self.watchdog_works = watchdog_works
        self.reset()

    def reset(self):
        self.buffer = b""
        self.mode, self.target = None, (0.0, 0.0, 0.0)
        self.limit, self.watchdog, self.fed = 20.0, 0.0, time.monotonic()
        self.refusals = 0
        self.session = 0

    def refuse(self, count):
        self.refusals = count

    def receive(self, data):
        self.buffer += data
        *lines, self.buffer = self.buffer.split(b"\n")
        return b"".join(self.checked(line.decode("latin-1")) for line in lines)

    def checked(self, line):
        body, _, check = line.rpartition(" ")
        right = sealed(body) == f"{body} {check}\n".encode("latin-1", "replace")
        return self.answer(body.split()) if right else b"what?\n"

    def idle(self):
        self.turn()
        if self.mode and self.watchdog and time.monotonic() - self.fed > self.watchdog:
            self.mode = None
            self.log.append("watchdog")
        return b""

    def turn(self):
        self.motor.advance(self.mode, *self.target)

    def measured(self):
        self.turn()
        m = self.motor
        return sealed(f"m {m.position!r} {m.speed!r} {m.current!r} {m.current_setpoint!r}")

    def answer(self, words):
        self.fed = time.monotonic()
        match words:
            case ["i"]:
                return sealed("toy 1")
            case ["m"]:
                return self.measured()
            case _ if self.refusals:
                self.refusals -= 1
                return sealed("refused")
            case ["s", _, *numbers]:
                self.turn()  # so far under the set point before
                self.target = tuple(float(number) for number in numbers)
                return self.measured() if self.mode else sealed("off")
            case ["e", mode]:
                self.turn()
                self.mode = mode
                self.target = (self.motor.position, 0.0, 0.0)
            case ["h"]:
                self.turn()
                self.mode = None
                self.log.append("halt")
            case ["l", value]:
                old, self.limit = self.limit, float(value)
                self.motor.current_limit = self.limit
                self.log.append(f"limit {value}")
                return sealed(f"ok {old!r}")
            case ["w", value]:
                self.watchdog = float(value) if self.watchdog_works else 0.0
            case _:
                return b"what?\n"
        return sealed("ok")


class ToyDrive:
    abilities = Abilities(
        frozenset({"position", "velocity", "current"}),
        True,
        frozenset({"current", "current_setpoint"}),
    )

    def __init__(self, line):
        self.line = line
        self.before = None
        self.mode = None

    def ask(self, request, kind, **options):
        def accept(text):
            body, _, check = text.rpartition(b" ")
            if not check.isdigit() or int(check) != sum(body) % 256:
                raise DamagedReply(f"{text!r}: wrong checksum")
            if body.startswith(b"refused"):
                raise HardwareError("toy: refuses")
            if body.startswith(b"off"):
                raise HardwareError("toy: is switched off: watchdog or reset")
            return body.split()[1:] if body.startswith(kind) else None

        return self.line.ask(sealed(request), accept, **options)

    def connect(self):
        return "toy " + self.ask("i", b"toy")[0].decode()

    def configure(self, limits, watchdog):
        before = float(self.ask(f"l {limits.current!r}", b"ok")[0])
        self.before = before if self.before is None else self.before
        self.ask(f"w {watchdog!r}", b"ok")
        return ["has no limit of speed"]

    def enable(self, mode):
        self.mode = mode
        self.ask(f"e {mode}", b"ok")

    def step(self, setpoint: SetPoint):
        numbers = f"{setpoint.position!r} {setpoint.speed!r} {setpoint.current!r}"
        return self.sample(self.ask(f"s {self.mode} {numbers}", b"m"))

    def read(self):
        return self.sample(self.ask("m", b"m"))

    def sample(self, words):
        position, speed, current, asked = (float(word) for word in words)
        return Sample(self.line.now(), position, speed, current, asked)

    def halt(self):
        self.ask("h", b"ok")

    def restore(self):
        if self.before is not None:
            self.ask(f"l {self.before!r}", b"ok")
            self.before = None
