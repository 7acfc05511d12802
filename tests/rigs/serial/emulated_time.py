"""Emulated time: it passes only while everybody waits, so nothing is ever late, and runs repeat.

Drivers, gauges, lines and emulated devices are the real ones; clocks, threads, queues and ports are
replaced. One thread runs at a time and hands over where it waits, always in the same order. Once
all wait, time jumps to the next moment at which something happens: bytes arrive, a timeout ends, a
device looks around. How fast the machine is, and what else runs on it, changes nothing.
"""

import contextlib
import errno
import functools
import importlib
import itertools
import math
import pkgutil
import queue
import sys
import threading
import time
import types
from pathlib import Path

import can.bus
import can.interfaces.slcan
import serial

import rigtool.rigs.serial
from rigtool.rigs.serial.emulators import server
from rigtool.rigs.serial.maxon import guard as maxon_guard
from rigtool.rigs.serial.transport import opening

PATIENCE = 3600.0
"""Emulated time after which a test is taken to wait for ever, s."""

REPLACED = (str(Path(rigtool.rigs.serial.__file__).parent), str(Path(__file__).parents[2]))
"""Folders whose modules see emulated clocks, threads and queues."""

for found in pkgutil.walk_packages(rigtool.rigs.serial.__path__, "rigtool.rigs.serial."):
    importlib.import_module(found.name)  # else one is first imported while time is emulated


class Ended(SystemExit):
    """The test is over: threads that still wait end here."""


class Task:
    """A thread that waits until `ready()` or a moment."""

    def __init__(self):
        self.ready, self.until, self.done = (lambda: True), math.inf, False
        self.turn = threading.Lock()
        self.turn.acquire()


class World:
    """The time [s] with the threads and devices in it.

    `delay` [s] is that of wires, each way, `rate` what they carry, byte/s; `stalls` maps times
    since the begin to how long the host is held up where it sleeps then, s. Devices that nobody
    asks anything look around every `tick` s.
    """

    def __init__(self):
        self.begin = self.now = 1000.0
        self.delay, self.rate = 1e-4, math.inf
        self.stalls = {}
        self.tick = server.IDLE_TIME
        self.servers, self.ports = [], {}
        self._ended = False
        self._number = itertools.count(9000)
        self._tasks = {threading.get_ident(): Task()}
        self._main = self._running = self._tasks[threading.get_ident()]

    # -- clocks

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.wait(lambda: False, self.now + seconds)
        for moment in [moment for moment in self.stalls if moment + self.begin <= self.now]:
            self.wait(lambda: False, self.now + self.stalls.pop(moment))

    # -- who runs

    def wait(self, ready, until=math.inf):
        """Let others run, and time pass, until `ready()` or a moment; return whether it is."""
        task = self._tasks[threading.get_ident()]
        assert task is self._running, "a thread of its own looks at emulated time"
        task.ready, task.until = ready, until
        self._hand_over()
        if self._ended:
            raise Ended
        if task is self._main and self.now - self.begin > PATIENCE:
            raise AssertionError(f"somebody waits for ever: {PATIENCE:g} s have passed")
        return ready()

    def _hand_over(self):
        """Give the turn to whoever is next, and wait for the own one unless it is over."""
        own = self._running
        following = self._next()
        if following is own:
            return
        self._running = following
        following.turn.release()
        if not own.done:
            own.turn.acquire()

    def _next(self):
        while True:
            for device in list(self.servers):
                if device.due() <= self.now:
                    device.run()
            now, tasks = self.now, list(self._tasks.values())
            place = tasks.index(self._running) + 1
            for task in (*tasks[place:], *tasks[:place]):
                if not task.done and (task.until <= now or task.ready()):
                    return task
            self.now = min(
                *(task.until for task in tasks if not task.done),
                *(device.due() for device in self.servers),
                *(port.arrives() for port in self.ports.values()),
                self.begin + 2 * PATIENCE,
            )
            if self.now - self.begin > PATIENCE:
                return self._main

    def start(self, work):
        """Run a function in a thread of this world; return its task."""
        task = Task()

        def run():
            task.turn.acquire()
            try:
                if not self._ended:
                    work()
            finally:
                task.done = True
                if not self._ended:
                    self._hand_over()

        task.thread = threading.Thread(target=run, daemon=True)
        task.thread.start()
        self._tasks[task.thread.ident] = task
        return task

    def end(self):
        """End the threads that still wait."""
        self._ended = True
        for task in self._tasks.values():
            if task is not self._main and not task.done:
                task.turn.release()
                task.thread.join()

    # -- what modules find in place of `time`, `threading` and `queue`

    def modules(self):
        names = {"monotonic": self.monotonic, "sleep": self.sleep, "perf_counter": self.monotonic}
        kinds = {
            kind.__name__: type(kind.__name__, (kind,), {"world": self})
            for kind in (Thread, Event, Condition)
        }
        blocks = type("Queue", (Queue,), {"world": self})
        return {
            time: types.SimpleNamespace(**vars(time) | names),
            threading: types.SimpleNamespace(**vars(threading) | kinds),
            queue: types.SimpleNamespace(**vars(queue) | {"Queue": blocks}),
        }

    def open_port(self, name, *arguments, exclusive=None, **options):
        """Take the place of `serial.serial_for_url`."""
        wire = self.ports.get(name)
        if wire is None:
            return REAL_PORT(name, *arguments, exclusive=exclusive, **options)
        if exclusive and wire.hosts:
            raise serial.SerialException(errno.EAGAIN, f"Could not exclusively lock port {name}")
        return Port(self, wire, options["timeout"])

    def open_socket(self, address, timeout):
        """Take the place of `sockets.Socket`."""
        wire = self.ports.get(opening.SOCKET_PREFIX + address)
        return REAL_SOCKET(address, timeout) if wire is None else Port(self, wire, timeout)


REAL_PORT, REAL_SOCKET = serial.serial_for_url, opening.Socket


# -- threads


class Thread:
    def __init__(self, target, args=(), name=None, daemon=None):
        self._work = lambda: target(*args)

    def start(self):
        self._task = self.world.start(self._work)

    def join(self, timeout=math.inf):
        self.world.wait(lambda: self._task.done, self.world.now + timeout)

    def is_alive(self):
        return not self._task.done


class Event:
    def __init__(self):
        self._set = False

    def set(self):
        self._set = True

    def clear(self):
        self._set = False

    def is_set(self):
        return self._set


class Condition:
    """One thread runs at a time: nothing is to be locked."""

    def __enter__(self):
        return self

    def __exit__(self, *details):
        pass

    def notify_all(self):
        pass

    def wait_for(self, known, timeout=math.inf):
        return self.world.wait(known, self.world.now + timeout)


class Queue:
    def __init__(self):
        self._items = []

    def put(self, item):
        self._items.append(item)

    def get(self):
        self.world.wait(lambda: bool(self._items))
        return self._items.pop(0)


# -- lines


BUFFER = 4096
"""Bytes that the ports of a line of limited rate hold."""


class Wire:
    """Bytes under way in both directions, each with the time of its arrival."""

    def __init__(self, world):
        self.world = world
        self.to_host, self.to_device = [], []
        self.hosts = self.reads = 0
        self.cut = False

    def send(self, way, data):
        """Send bytes behind those that are under way; none are nothing."""
        if not data:
            return
        begin = max([self.world.now + self.world.delay, *(moment for moment, _ in way[-1:])])
        way.append((begin + len(data) / self.world.rate, bytes(data)))

    def room(self, way):
        """Return how many bytes are taken now, as by the buffer of a port."""
        under_way = sum(len(data) for _, data in way)
        return sys.maxsize if self.world.rate == math.inf else max(0, BUFFER - under_way)

    def arrived(self, way):
        now = self.world.now
        return sum([len(data) for moment, data in way if moment <= now])

    def ready(self, way):
        """Return whether bytes have arrived: the first are the earliest."""
        return bool(way) and way[0][0] <= self.world.now

    def take(self, way, size):
        got = b""
        while way and way[0][0] <= self.world.now and len(got) < size:
            moment, data = way.pop(0)
            if left := data[size - len(got) :]:
                way.insert(0, (moment, left))
            got += data[: size - len(got)]
        return got

    def arrives(self):
        """Return when the host gets the next bytes, s; those that have arrived do not count."""
        now = self.world.now
        for moment, _ in self.to_host:
            if moment > now:
                return moment
        return math.inf


TAKEN = "device reports readiness to read but returned no data (multiple access on port?)"
"""What pyserial says where another program was quicker."""


class Port:
    """What a `Line` has instead of a serial port."""

    def __init__(self, world, wire, timeout):
        self._world, self._wire, self._timeout = world, wire, timeout
        self.write_timeout = None
        wire.hosts += 1
        self._open = True

    def _require(self):
        if self._wire.cut:
            raise OSError(errno.EIO, "Input/output error")
        if not self._open:
            raise TypeError("the port is closed")

    @property
    def in_waiting(self):
        self._require()
        return self._wire.arrived(self._wire.to_host)

    def read(self, size):
        self._require()
        wire = self._wire
        reads = wire.reads
        self._world.wait(
            lambda: wire.cut or not self._open or wire.ready(wire.to_host),
            self._world.now + self._timeout,
        )
        self._require()
        data = wire.take(wire.to_host, size)
        wire.reads += bool(data)
        if not data and wire.reads > reads:
            raise serial.SerialException(TAKEN)
        return data

    def write(self, data):
        self._require()
        if data:
            self._wire.send(self._wire.to_device, data)

    def flush(self):
        self._require()

    def reset_input_buffer(self):
        self._wire.to_host.clear()

    def close(self):
        if self._open:
            self._open = False
            self._wire.hosts -= 1


def server_kind(world, name):
    """Return a server that runs where time passes, not in a thread; `name` is that of its ports."""

    class EmulatedServer(server.Server):
        def start(self):
            self._open()
            self._tick = world.now
            world.servers.append(self)

        def stop(self):
            if self in world.servers:
                world.servers.remove(self)
                self._close()

        def due(self):
            if self.emulator.busy and not self._waiting:
                return world.now
            due, under_way = self._tick + world.tick, self._wire.to_device
            return under_way[0][0] if under_way and under_way[0][0] < due else due

        def run(self):
            """Do what the thread does in one round."""
            self._tick, goes_on = world.now, False
            try:
                goes_on = self.serve_once()
            finally:
                if not goes_on:
                    self.stop()

        def _open(self):
            self.port = f"{name}{next(world._number)}"
            self._wire = world.ports[self.port] = Wire(world)

        def _ready(self, timeout):
            return self._wire.ready(self._wire.to_device)

        def _read(self):
            return self._wire.take(self._wire.to_device, server.READ_BYTES)

        def _write(self, data):
            taken = data[: self._wire.room(self._wire.to_host)]
            if taken:
                self._wire.send(self._wire.to_host, taken)
            return len(taken)

        def _close(self):
            self._wire.cut = True
            del world.ports[self.port]

    return EmulatedServer


@functools.cache
def users(wanted, loaded):
    """Return pairs of a module and what it uses of these; `loaded` modules, else it looks anew."""
    where = {module: getattr(module, "__file__", None) or "" for module in sys.modules.values()}
    return [
        (module, real)
        for module, path in where.items()
        if path.startswith(REPLACED) and path != __file__
        for real in wanted
        if vars(module).get(real.__name__) is real
    ]


@contextlib.contextmanager
def emulated_time(monkeypatch):
    """Yield a `World`; who opens a port or starts a thread from now on lives in it."""
    world = World()
    replaced = world.modules()
    for module, real in users(tuple(replaced), len(sys.modules)):
        if vars(module).get(real.__name__) is real:
            monkeypatch.setattr(module, real.__name__, replaced[real])
    monkeypatch.setattr(server, "PtyServer", server_kind(world, "/dev/pts/"))
    monkeypatch.setattr(server, "TcpServer", server_kind(world, "socket://127.0.0.1:"))
    monkeypatch.setattr(serial, "serial_for_url", world.open_port)
    monkeypatch.setattr(serial.Timeout, "TIME", world.monotonic)
    monkeypatch.setattr(can.bus, "time", world.monotonic)
    monkeypatch.setattr(can.interfaces.slcan, "time", replaced[time])
    monkeypatch.setattr(opening, "Socket", world.open_socket)
    # A process of its own lives in real time: it would hear nothing for long, and switch off.
    monkeypatch.setattr(maxon_guard.Guard, "_start", lambda guard: None)
    monkeypatch.setattr(maxon_guard.Guard, "_send", lambda guard, word: None)
    try:
        yield world
    finally:
        world.end()
