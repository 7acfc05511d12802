"""`python -m rigtool` is the command line as well."""

from rigtool.cli import main

main()
