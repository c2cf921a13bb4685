"""Scenarios: set-ups saved as small JSON files, those built in, and how one is staged."""
