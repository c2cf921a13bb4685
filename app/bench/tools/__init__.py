"""Shared by the benchmarks: settings, description of the machine, report, headless browser."""
