"""Model files that people write, drawn by hypothesis: with anything changed one is a model or a sentence, and
what is read can be written and read again.
"""

import tempfile
from pathlib import Path

import hypothesis
from hypothesis import strategies as st

from jaxbound.models.modelfile import load_model, model_text, template

TEXT = "\n".join(line for line in template().splitlines() if line and not line.startswith("#")) + "\n"
SIGNS = "019.,eE-+/\"'[]{}=# \n\r\t\0_abn\ufeff\u2028ä"
CHANGES = st.lists(
    st.tuples(st.integers(0, len(TEXT)), st.integers(0, 5), st.text(st.sampled_from(SIGNS), max_size=4)),
    max_size=3,
)


def load(text):
    """Return the model that a text describes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.toml"
        path.write_bytes(text.encode())
        return load_model(path)


@hypothesis.settings(max_examples=80)
@hypothesis.given(CHANGES)
def test_a_changed_model_file_is_a_model_or_a_sentence(changes):
    text = TEXT
    for at, length, piece in changes:
        text = text[:at] + piece + text[at + length :]
    try:
        model = load(text)
    except ValueError as error:
        words = str(error)
        assert 10 < len(words) < 2300 and words.isprintable(), words
    else:
        assert model_text(load(model_text(model))) == model_text(model)
