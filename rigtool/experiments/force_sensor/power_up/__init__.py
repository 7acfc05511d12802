"""Ripple that an amplifier draws anew at each power-up, learned while the rotor slides."""
