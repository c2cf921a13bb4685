"""The scene of a session, arm and mesh, and how it is built."""
