"""What is measured, shown while it is measured."""
