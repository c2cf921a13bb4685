"""Which planes constrain the tool: certified, the paper's, corridors, ways out of a body."""
