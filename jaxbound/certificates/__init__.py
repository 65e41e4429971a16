"""Exact proofs of one window, for people and as JSON: one file a kind of relation, each registers what it
proves.
"""

from jaxbound.certificates.certificate import Certificate
from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.certificates.interface import WindowCertificate, certificate_of, certify
from jaxbound.certificates.long_window import LongCertificate
from jaxbound.certificates.residual_certificate import ResidualCertificate
from jaxbound.certificates.uncertain_certificate import UncertainCertificate
from jaxbound.certificates.verification import verify

__all__ = [
    "Certificate",
    "Diagnosis",
    "LongCertificate",
    "ResidualCertificate",
    "UncertainCertificate",
    "WindowCertificate",
    "certificate_of",
    "certify",
    "verify",
]
