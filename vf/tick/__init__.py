"""One tick of the control loop in one compiled call, and the block of memory it works in."""
