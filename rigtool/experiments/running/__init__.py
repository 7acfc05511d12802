"""Running a command: from its sources and options over the rig to the output, shown live."""
