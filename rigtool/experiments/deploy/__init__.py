"""Learned tables for drives and firmware: rounded, stored, exported."""
