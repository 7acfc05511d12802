"""Maxon drives: EPOS4 and DES."""
