"""The checker as tests of certificates call it: on the model and the samples that the certificate itself
shows.
"""

from jaxbound.certificates.checker.claim import numbers
from jaxbound.certificates.checker.proof import confirm

__all__ = ["confirm", "numbers"]
