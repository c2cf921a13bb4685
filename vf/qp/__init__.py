"""The least squares problem of a tick, and the solvers behind one interface."""
