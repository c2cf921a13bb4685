"""Campaigns that try to break the fixtures, and the oracles that judge them."""
