"""The target, which runs whole motions by itself."""
