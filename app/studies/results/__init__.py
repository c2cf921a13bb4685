"""What came of the experiments: statistics, the paper's figures to compare with, the report."""
