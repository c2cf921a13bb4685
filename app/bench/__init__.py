"""Benchmarks: run time over mesh sizes, comparison with other libraries, the control thread."""
