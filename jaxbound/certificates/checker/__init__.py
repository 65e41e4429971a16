"""The checker of certificates: exact fractions and the standard library, no line of it shared with what found
the proof.

It needs neither JAX nor NumPy, and this folder runs by itself, wherever it lies:

    python -I DIR CERTIFICATE.json --model MODEL.toml --data RUN.csv
"""
