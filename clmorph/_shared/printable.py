"""Text for people: foreign text on one printable line, and sizes, times and shares."""

import unicodedata

#: Characters of a value (a name, a key) and of a whole message, at most.
VALUE, MESSAGE = 300, 1000
#: Characters without a shape that belong to words: Persian joins letters by them, emoji too.
JOINERS = "\u200c\u200d"


def printable(text: object, most: int = VALUE) -> str:
    r"""Return a text so that it can stand in a message and on a terminal.

    Parameters
    ----------
    text : object
        A file name, a key or a value out of a file, or a whole message.
    most : int
        Characters of the result, at most; what is too much is left out of the middle.

    Returns
    -------
    str
        Control characters, line breaks and marks that reverse the direction of writing are
        shown as escapes such as ``\x1b``, spaces of any width as plain ones, bytes of a name that
        are no text as U+FFFD.
    """
    # Shortened twice: before, so that a megabyte is not walked through; after, for escapes.
    short = _shortened(str(text), most)
    return _shortened("".join(map(_shown, short)), most)


def reason_of(error: BaseException, most: int = VALUE) -> str:
    """Return what an error of the system or of a library says, on one short line.

    Parameters
    ----------
    error : exception
    most : int
        Characters of the result, at most.

    Returns
    -------
    str
        An OSError's own words without its number and file; the class of an error without words.
    """
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
    if unicodedata.category(character) == "Zs":  # macOS puts narrow ones into names
        return " "
    if "\ud800" <= character <= "\udfff":
        return "\ufffd"
    return character.encode("unicode_escape").decode("ascii")


def size_text(n_bytes: float) -> str:
    """Return a number of bytes for people."""
    units = ["bytes", "kB", "MB", "GB", "TB"]
    power = 0
    while n_bytes >= 999.5 and power < len(units) - 1:
        n_bytes, power = n_bytes / 1000.0, power + 1
    return f"{_three(n_bytes)} {units[power]}"


def time_text(seconds: float) -> str:
    """Return a time for people."""
    if seconds < 0.9995:
        return f"{_three(1000 * seconds)} ms"
    return f"{_three(seconds)} s" if seconds < 99.5 else f"{_three(seconds / 60)} min"


def percent(share: float) -> str:
    """Return a share for people."""
    return f"{_three(100 * share)} %"


def _three(number: float) -> str:
    """Return a number of at least 0 with about three digits, never as a power of ten."""
    if number >= 99.95:
        return f"{number:.0f}"
    return f"{number:.3g}" if number >= 1e-4 or number == 0 else "under 0.0001"
