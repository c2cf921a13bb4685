"""Exports of recordings for other programs: `table` as CSV, `bag` as MCAP."""
