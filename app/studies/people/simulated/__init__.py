"""Simulated operators take a study, through the sitting and the session that people have."""
