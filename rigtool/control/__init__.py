"""The position loop as a model, and the table that is fed forward in it."""
