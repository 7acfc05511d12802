"""The ways to learn: one module an implementation of section 7.2.4, and what they share."""
