"""What the bench does: motions, loads, what to record, then which analysis."""
