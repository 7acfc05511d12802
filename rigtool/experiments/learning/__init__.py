"""Iterative learning of a feed-forward table."""
