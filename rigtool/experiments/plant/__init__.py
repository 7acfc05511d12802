"""The plant identified: excitation, frequency response, fit, margins."""
