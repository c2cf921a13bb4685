"""The panel on the left: read-outs, signals, the mesh, recordings."""
