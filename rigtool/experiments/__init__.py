"""Experiments: motions, loads, recordings, and their analysis."""
