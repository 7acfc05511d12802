"""The effects of a load on the motor's torque, learned at known loads."""
