"""Force over time from current: in recordings and live, with contacts and accuracy."""
