"""Real recordings to tidy tables."""
