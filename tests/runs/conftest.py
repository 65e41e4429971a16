"""What tests of runs in parts compare with."""

import pytest
from streaming_case import shrink

from jaxbound.runs.digest import detect_dataset


@pytest.fixture(scope="module")
def one(case, tmp_path_factory):
    """Return (folder, Digest) of one process that does it all."""
    r, folder, _, _ = case("section 5")
    out = tmp_path_factory.mktemp("one")
    with pytest.MonkeyPatch.context() as patch:
        shrink(patch)
        return out, detect_dataset(r, folder, out)
