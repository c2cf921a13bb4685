"""What is wrong with a mesh, and its repair: topology, bodies, self-intersections, welding."""
