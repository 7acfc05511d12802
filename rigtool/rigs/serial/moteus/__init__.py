"""Moteus drives."""
