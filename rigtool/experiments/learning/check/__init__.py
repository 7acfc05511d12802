"""Whether a learned table still fits the rig."""
