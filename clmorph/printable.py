"""Text of foreign origin in messages: on one line, printable, of bounded length."""

#: Characters of a value (a name, a key) and of a whole message, at most.
VALUE, MESSAGE = 300, 1000


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
        shown as escapes such as ``\x1b``; bytes of a name that are no text as U+FFFD.
    """
    # Shortened twice: before, so that a megabyte is not walked through; after, for escapes.
    short = _shortened(str(text), most)
    return _shortened("".join(map(_shown, short)), most)


def _shortened(text: str, most: int) -> str:
    if len(text) <= most:
        return text
    start = (most - 1) // 2
    return f"{text[:start]}…{text[start + 1 - most :]}"


def _shown(character: str) -> str:
    if character.isprintable():
        return character
    if "\ud800" <= character <= "\udfff":
        return "\ufffd"
    return character.encode("unicode_escape").decode("ascii")
