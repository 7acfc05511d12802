"""Commands on stored runs: compare, check, bring back, write for other programs, draw."""
