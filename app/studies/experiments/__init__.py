"""The paper's experiments in silico: simulated operators on the real controller."""
