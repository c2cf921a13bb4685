"""Imported by the process that processes are forked from, so that they record at once."""

import killed

killed.prepare()
