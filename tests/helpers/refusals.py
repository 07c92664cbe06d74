"""What the command line says of a mistake."""

from collections.abc import Callable

import pytest

from clmorph.cli.main import main

#: What may be printed before an error, on lines of their own.
REMARKS = ("device:", "preset:", "memory:", "note:", "landmarks:", "labels:")


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run the command line, which must end with 2 and one line of error, and return that line."""

    def run(*arguments: object) -> str:
        capfd.readouterr()
        assert main([*map(str, arguments)]) == 2, arguments
        out, err = capfd.readouterr()
        assert out == ""
        lines = [line for line in err.splitlines() if not line.startswith(REMARKS)]
        assert len(lines) == 1, err
        assert lines[0].startswith("clmorph: error: ")
        assert lines[0].isprintable()
        assert len(lines[0]) < 1200
        return lines[0]

    return run
