"""The model of the position loop, and the table of torque that is fed forward in it."""
