"""Linear systems whose coefficients are intervals."""
