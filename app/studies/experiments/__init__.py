"""The paper's experiments in simulation: a simulated operator with the real controller."""
