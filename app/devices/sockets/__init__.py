"""Devices over UDP in the dialect of the dVRK's socket streamer: one JSON object a datagram."""
