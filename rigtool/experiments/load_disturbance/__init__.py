"""What a load changes, learned at known loads."""
