"""Waveforms without attenuation, as of samples close to each other."""

from rigtool.experiments.ripple.orders import Sampling

FINE = Sampling(0.0)
