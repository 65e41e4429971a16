"""Text from files and users: whole, printable, never a formula, never without end."""

import pytest

from jaxbound.text.characters import cell, clipped, printable
from jaxbound.text.names import listed, quoted


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@x", "\x00=x"])
def test_no_cell_begins_like_a_formula(name):
    assert cell(name)[0] in "'\\" and cell("pump 7") == "pump 7"


@pytest.mark.parametrize("code", [0, 31, 127, 159, 0x200E, 0x2028, 0x202E, 0x2066, 0xD800, 0xDFFF])
def test_what_moves_a_cursor_or_cannot_be_encoded_is_escaped(code):
    text = printable(f"a{chr(code)}b")
    assert text.isprintable() and text.isascii() and text[0] + text[-1] == "ab"


@pytest.mark.parametrize("text", ["a b", "\u00b0C", "\u00a0", "\u2030"])
def test_what_harms_nobody_stays(text):
    assert printable(text) == text


def test_what_is_kept_stays():
    assert printable("a\nb\x1b", "\n") == "a\nb\\x1b"


def test_a_long_text_loses_its_middle():
    text = clipped("a" + "x" * 10**6 + "b")
    assert len(text) < 2100 and text[0] + text[-1] == "ab" and "998002 characters" in text


def test_many_names_are_counted_and_a_long_one_is_cut():
    assert listed(["a"] * 13, str).count("a") == 13
    assert listed(["a"] * 14, str) == ", ".join(["a"] * 12) + " and 2 more"
    assert quoted("y" * 81) == f"{'y' * 80!r} .. (81 characters)"
