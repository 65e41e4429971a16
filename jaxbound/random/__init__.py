"""Random numbers: keys, and the cipher of a count that both JAX and the studies draw by."""
