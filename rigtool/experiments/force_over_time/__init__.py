"""Torque on the output over time, from the motor's torque and its encoder."""
