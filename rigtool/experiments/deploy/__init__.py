"""A learned table on its way into a drive: made coarse, stored."""
