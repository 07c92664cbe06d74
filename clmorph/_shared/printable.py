"""Text for people: foreign text as one printable line, and formatted sizes, times and shares."""

import unicodedata

#: Largest number of characters of a value (a name, a key) and of a whole message.
VALUE, MESSAGE = 300, 1000
#: Invisible characters that belong to words: Persian and emoji use them to join characters.
JOINERS = "\u200c\u200d"


def printable(text: object, most: int = VALUE) -> str:
    """Return a text as one line that is safe on a terminal: controls escaped, a middle cut out."""
    # The text is shortened twice: first to avoid escaping a megabyte, and again after escaping.
    short = _shortened(str(text), most)
    return _shortened("".join(map(_shown, short)), most)


def reason_of(error: BaseException, most: int = VALUE) -> str:
    """Return an error's message as one line, without number and file, or else its class."""
    told = str(getattr(error, "strerror", None) or error)
    return printable(" ".join(told.split()) or type(error).__name__, most)


def _shortened(text: str, most: int) -> str:
    if len(text) <= most:
        return text
    start = (most - 1) // 2
    return f"{text[:start]}…{text[start + 1 - most :]}"


def _shown(character: str) -> str:
    if character.isprintable() or character in JOINERS:
        return character
    if unicodedata.category(character) == "Zs":  # macOS puts narrow spaces into file names
        return " "
    if "\ud800" <= character <= "\udfff":
        return "\ufffd"
    return character.encode("unicode_escape").decode("ascii")


def size_text(n_bytes: float) -> str:
    """Format a number of bytes for people."""
    units = ["bytes", "kB", "MB", "GB", "TB"]
    power = 0
    while n_bytes >= 999.5 and power < len(units) - 1:
        n_bytes, power = n_bytes / 1000.0, power + 1
    return f"{_three(n_bytes)} {units[power]}"


def time_text(seconds: float) -> str:
    """Format a time for people."""
    if seconds < 0.9995:
        return f"{_three(1000 * seconds)} ms"
    return f"{_three(seconds)} s" if seconds < 99.5 else f"{_three(seconds / 60)} min"


def percent(share: float) -> str:
    """Format a share as a percentage for people."""
    return f"{_three(100 * share)} %"


def _three(number: float) -> str:
    """Format a number of at least 0 with about three digits, never in scientific notation."""
    if number >= 99.95:
        return f"{number:.0f}"
    return f"{number:.3g}" if number >= 1e-4 or number == 0 else "under 0.0001"
