"""Other ends of a line than a serial port: a socket, a CAN bus, a record."""
