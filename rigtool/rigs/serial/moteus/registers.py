"""Numbers of the registers of a moteus drive, and values of the register MODE.

Source: mjbots/moteus, docs/reference.md.
"""

from __future__ import annotations

MODE, POSITION, VELOCITY, TORQUE, CURRENT = range(5)
MOTOR_TEMPERATURE, FAULT = 0x00A, 0x00F
COMMAND = 0x020
"""First of position, velocity, feed-forward torque, kp scale, kd scale, largest torque."""
COMMAND_TIMEOUT, COMMAND_INTEGRAL, CONTROL_TORQUE = 0x027, 0x02B, 0x034
IDENTITY, SERIAL_NUMBER = 0x100, 0x120

STOPPED, FAULTY, IN_POSITION, TIMED_OUT = 0, 1, 10, 11
