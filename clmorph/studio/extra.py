"""What the extra ``studio`` brings, and the error where it is missing."""

from importlib.util import find_spec

from clmorph.errors import InputError


def need_studio() -> None:
    """Raise an error that says what to install if the extra ``studio`` is missing."""
    if any(find_spec(name) is None for name in ("starlette", "uvicorn")):
        raise InputError('the studio needs the extra "studio": pip install "clmorph[studio]"')
