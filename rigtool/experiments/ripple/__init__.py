"""Ripple of the torque by orders of the turn."""
