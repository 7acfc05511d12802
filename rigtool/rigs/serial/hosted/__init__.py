"""Rigs whose loop is closed in a drive, and whose set points the host sends one by one."""
