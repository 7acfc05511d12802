"""`python -m rigtool`."""

from rigtool.cli import main

main()
