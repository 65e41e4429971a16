"""Relations: how unknowns are eliminated."""
