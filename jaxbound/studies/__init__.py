"""Many evaluations of the floors below: fitting, tuning, Monte-Carlo studies."""
