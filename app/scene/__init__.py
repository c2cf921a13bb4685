"""What the tool is placed among: the arm and the mesh of a session, and how they are built."""
