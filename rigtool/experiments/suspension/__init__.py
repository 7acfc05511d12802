"""The leaf springs of the motor, and eccentric pulleys."""
