"""Is a learned table still right?"""
