"""Heat map of the margins that structures are guarded with."""
