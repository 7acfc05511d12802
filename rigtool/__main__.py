"""`python -m rigtool` runs the command line."""

from rigtool.cli import main

main()
