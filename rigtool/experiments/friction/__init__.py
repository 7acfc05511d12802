"""Friction over speed: sweeps, holds, breakaway, fits."""
