"""Imported by the process that processes are forked from, so that they record at once."""

from tests.support import killed

killed.prepare()
