"""Escapes of characters that a terminal or a spreadsheet would obey, for texts of unknown origin."""

from __future__ import annotations

import unicodedata

_KEPT = "\n\t\u200c\u200d"
"""Newline, tab, and the joiners of Persian, Hindi and emoji."""

_FORMULAS = ("=", "+", "-", "@", "\t", "\n")
"""First characters of spreadsheet formulas; a spreadsheet skips the last two."""


def printable(text: str) -> str:
    """Return a text with every control character and mark of direction as its escape: ESC as `\\x1b`."""
    if text.isprintable():
        return text
    # By the signs that occur: a report has millions of characters.
    return text.translate({ord(sign): _shown(sign) for sign in set(text)})


def _shown(sign: str) -> str:
    # str.isprintable accepts no space but U+0020.
    if sign.isprintable() or sign in _KEPT or unicodedata.category(sign) == "Zs":
        return sign
    if "\udc80" <= sign <= "\udcff":
        return f"\\x{ord(sign) - 0xDC00:02x}"  # a byte of a file name that is not UTF-8
    return sign.encode("unicode_escape", "surrogatepass").decode("ascii")


def spreadsheet_text(text: str) -> str:
    """A text as a cell of a CSV file: printable, and no formula of a spreadsheet, by an apostrophe (OWASP)."""
    text = printable(text)
    return f"'{text}" if text.startswith(_FORMULAS) else text
