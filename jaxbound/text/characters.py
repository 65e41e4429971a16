"""Text from files and users, made safe: no control characters, no formula of a spreadsheet, no text without
end.
"""

FORMULAS = ("=", "+", "-", "@")
"""A cell that begins so is computed, not shown, by a spreadsheet."""
LONGEST = 2000
"""Characters of a sentence."""
HARMFUL = (
    (0x00, 0x1F),  # control characters
    (0x7F, 0x9F),
    (0x200E, 0x200F),  # marks and overrides of the direction of writing
    (0x2028, 0x2029),  # ends of lines and paragraphs
    (0x202A, 0x202E),
    (0x2066, 0x2069),
    (0xD800, 0xDFFF),  # surrogates: UTF-8 cannot hold them
)
"""The first and the last code point of each range that is escaped."""


def printable(text: str, keep: str = "") -> str:
    r"""Return a text whose control characters, and those that UTF-8 cannot hold, are written as escapes.

    A name from a file may hold what would move the cursor of a terminal, or hide what follows.

    Args:
        keep: characters that stay as they are.

    Example:
        >>> printable("y1\x1b[2J")
        'y1\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(c if c in keep or _is_harmless(c) else _escape(c) for c in text)


def _is_harmless(character: str) -> bool:
    code = ord(character)
    return not any(first <= code <= last for first, last in HARMFUL)


def _escape(character: str) -> str:
    return character.encode("unicode_escape").decode()


def clipped(text: str) -> str:
    """Return a text without its middle if it is very long."""
    if len(text) <= LONGEST:
        return text
    return f"{text[: LONGEST // 2]} [.. {len(text) - LONGEST} characters ..] {text[-LONGEST // 2 :]}"


def cell(text: str) -> str:
    """Return a text as a cell of CSV that no spreadsheet takes for a formula.

    Control characters are escaped, and an apostrophe stands before = + - @.

    Source: OWASP, CSV injection.

    Example:
        >>> cell("=1+1"), cell("pump 7")
        ("'=1+1", 'pump 7')
    """
    text = printable(text)
    if text.startswith(FORMULAS):
        return f"'{text}"
    return text
