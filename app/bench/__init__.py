"""Measurements: run time over mesh sizes, other libraries beside ours, the control thread."""
