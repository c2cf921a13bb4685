"""Stand-ins for arms and consoles behind the dVRK's socket streamer, each for a process of its own.

`arm`, `console`, `kinematics` and `wire` use nothing of the rest of the program: they are what its
devices are tried against.
"""
