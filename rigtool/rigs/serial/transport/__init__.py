"""What a line can be at its other end, beside a serial port: a socket, a CAN bus, a record."""
