"""ODrive drives, old and new dialect."""
