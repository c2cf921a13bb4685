"""Studies without a person: the safety campaign, the paper's experiments, and their results."""
