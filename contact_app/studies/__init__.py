"""Studies: the paper's tables and figures again, ours beside theirs."""
