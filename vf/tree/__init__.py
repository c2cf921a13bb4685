"""The PD-tree of a mesh's triangles, and what is asked of it: distances, winding numbers."""
