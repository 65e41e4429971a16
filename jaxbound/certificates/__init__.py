"""Exact proofs of one window, for people and as JSON: one file a kind of relation."""

from jaxbound.certificates import certificate, residual_certificate, uncertain_certificate  # noqa: F401 (each registers what it proves)
