"""How anatomy moves, what a tracker sees of it, and where the guard believes it to be."""
