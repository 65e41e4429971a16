"""Enclosures of JAX functions over boxes."""
