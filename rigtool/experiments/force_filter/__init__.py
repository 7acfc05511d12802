"""Torque on the output as a state: the filter over motor, bristles, tendon and torque."""
