"""The virtual rig: a simulation of the physics of motor, amplifier, instrument and sensors."""

from rigtool.rigs.virtual.rig import VirtualRig

__all__ = ["VirtualRig"]
