"""A bench with an emulated drive: motor, arm, weights and heater, and who handles them.

The operator does at the motor what rigtool asks for, in the words in which it asks.
"""

import math
import re
from dataclasses import dataclass, field, replace

from rigtool.experiments.running import session
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.emulators.motor import EmulatedMotor

ARM, RADIUS = 0.540, 0.014
"""Length of the arm and radius of the pulley in the shipped recipes, m."""


@dataclass
class BenchMotor(EmulatedMotor):
    """A motor that can be clamped and heated, with ripple: (order, N m, phase) each.

    The constant falls by `coefficient` a kelvin above 25 degC. `integrator` rad/s is that of the
    drive's loop, next to the gains of `EmulatedMotor`.
    """

    clamped: bool = False
    degc: float = 25.0
    coefficient: float = -1e-3
    ripple: tuple = ((6, 1e-3, 0.4),)
    integrator: float = 0.0
    cold_constant: float = field(init=False)
    _integral: float = 0.0

    def __post_init__(self):
        self.cold_constant = self.torque_constant

    def _step(self, dt, mode, position, speed, current):
        self.torque_constant = self.cold_constant * (1 + self.coefficient * (self.degc - 25.0))
        here = self.position
        if mode is not None:
            torque = sum(size * math.sin(n * here + phase) for n, size, phase in self.ripple)
            self.speed += dt * torque / self.inertia
        self._integral += dt * self._grows_by(mode, position, speed)
        super()._step(dt, mode, position, speed, current + self._integral)
        if self.clamped:
            self.position, self.speed = here, 0.0

    def _grows_by(self, mode, position, speed):
        if mode not in ("position", "velocity"):
            self._integral = 0.0
            return 0.0
        wanted = speed
        if mode == "position":
            wanted += self.gain_position * (position - self.position)
        return self.integrator * self.gain_speed * (wanted - self.speed)

    def tune(self, controller, inertia):
        """Give the drive's loop the gains of a recipe's [rig.controller]."""
        crossover = 2 * math.pi * controller.crossover_hz
        self.gain_speed = crossover * inertia / self.torque_constant
        self.gain_position = crossover / controller.lead_ratio
        self.integrator = 2 * math.pi * controller.integrator_hz

    @property
    def push(self):
        """Force of the arm on the gauge, N."""
        return self.torque_constant * self.current / ARM if self.clamped else 0.0


class Person:
    """Does what is asked for at a motor; `asked` and `said` keep the words."""

    def __init__(self, motor, power_cycle=lambda: None):
        self.motor, self._power_cycle = motor, power_cycle
        self.asked, self.said = [], []

    def operator(self, **asked):
        """Return the operator of a session."""
        own = Operator(ask=self.ask, say=self.said.append, present=True)
        return replace(own, **asked)

    def at_the_terminal(self, monkeypatch):
        """Let the commands ask this person."""
        monkeypatch.setattr(session, "Operator", self.operator)

    def ask(self, question):
        self.asked.append(question)
        motor = self.motor
        if question == "temperature [degC]:":
            return f"{motor.degc:g}"
        if found := re.match(r"Bring the motor to (\S+) degC", question):
            motor.degc = float(found[1])
        elif found := re.match(r"Clamp the arm .* shaft at (\S+) deg", question):
            motor.clamped, motor.load = True, 0.0
            motor.position = round_to(motor.position, math.radians(float(found[1])))
            motor.speed = 0.0
        elif question.startswith("Switch the amplifier off"):
            self._power_cycle()
        elif "the force gauge" in question:
            self._load(question)
        return ""

    def _load(self, question):
        motor = self.motor
        motor.clamped = "is clamped on" in question
        hung = re.search(r"[Hh]ang (\S+) N", question)
        motor.load = float(hung[1]) * RADIUS if hung else 0.0


def round_to(position, angle):
    """Return the angle, of any turn, that is nearest to a position, rad."""
    turn = 2 * math.pi
    return angle + turn * round((position - angle) / turn)
