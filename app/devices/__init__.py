"""Devices: masters, which the operator moves, and arms. See `protocols`."""
