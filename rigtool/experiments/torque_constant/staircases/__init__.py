"""Torque constant of each staircase of current, with friction and heat taken out of its slope."""
