"""A model of load learned from runs of other rigs."""
