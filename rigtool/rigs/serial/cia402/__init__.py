"""Drives of CiA 402: their states and settings, and CANopen, over which they are reached."""
