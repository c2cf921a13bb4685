"""Judges of what the rule promises, which share no code with it."""
