"""From healthy recordings to a model."""
