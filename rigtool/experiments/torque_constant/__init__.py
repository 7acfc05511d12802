"""Torque constant from a staircase of known loads."""
