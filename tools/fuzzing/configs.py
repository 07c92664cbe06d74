"""Odd files of settings give a run that follows them, or one line of error, and no other file."""

import json
import os
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from clmorph.cli.main import main
from clmorph.cli.main import morph as command
from clmorph.output.provenance import read_parameters
from fuzzing.mutations import mutated
from fuzzing.quiet import Quiet

#: Seconds that one run may take.
PATIENCE = 20.0
#: Characters of an error.
LONGEST = 1500
#: What the runs print beside errors.
REMARKS = ("device:", "memory:", "note:", "preset:")
#: Files that clmorph writes, by ending.
KINDS = ("gif", "png", "apng", "webp", "html", "npz", "mp4", "tif")
#: Values of every type that TOML and JSON have, at their limits.
NASTY: tuple[Any, ...] = (
    True, False, 0, 1, -1, 2, 3, 1 << 31, -(1 << 63), 10**400, 0.0, -0.0, 0.5, 1e-320, 1e308,
    float("inf"), float("-inf"), float("nan"), "", "auto", "balanced", "none", "off", "optimal",
    "0", "1e999", "nan", "ä\x1b[31m\n", "x" * 5000, "../out", "/dev/null", "3x3", "0x0", "-1x5",
    "99999999x99999999", "source", "linear", "#fff", "red", "white", [], [1], [1, 2, 3], ["a", "b"],
    [[1]], [True], {}, {"a": 1}, [{"file": "a.png"}], [{"file": 5}], [None],
)  # fmt: skip
#: Options whose good values are words of a choice of their own.
WORDS = ("auto", "balanced", "linear", "source", "target", "8x8", "white", "1", "optimal", 0.1, 2)


class Target:
    """Cases of this kind, whose runs are made in a folder."""

    def __init__(self, folder: Path) -> None:
        os.chdir(folder)
        rng = np.random.default_rng(0)
        for name, shape in (("a.png", (5, 6, 3)), ("b.png", (6, 4, 3))):
            Image.fromarray(rng.integers(0, 255, shape, np.uint8)).save(name)
        self.folder = folder
        names = ("images", "config")
        self.options = {str(each.name): each for each in command.params if each.name not in names}
        self.written: dict[str, bytes] = {}
        for kind in KINDS:
            with Quiet():
                main(["morph", "a.png", "b.png", "-o", f"out.{kind}", *SMALL, "--backend", "numpy"])
            file = folder / f"out.{kind}"
            if file.exists():  # videos take PyAV
                self.written[kind] = file.read_bytes()
                self.told = read_parameters(file)
                file.unlink()

    def case(self, rng: np.random.Generator) -> tuple[str, bytes, Callable[[], list[str]]]:
        """Return what is tried, the offending input if it offends, and what tries it."""
        makers = (self._toml, self._recipe, self._damaged_file, self._embedded)
        name, data = makers[rng.integers(len(makers))](rng)
        arguments = ["morph", "--config", name, "--size", "6", "--frames", "3"]
        if rng.random() < 0.5:
            arguments += ["--dump-config"]
        else:
            arguments += ["--backend", "numpy", "--max-iter", "30"]
            arguments += ["-o", "out.gif"] if rng.random() < 0.6 else []
        return f"{name} {' '.join(arguments)}", data, lambda: self.run(name, data, arguments)

    # What is tried.

    def _value(self, rng: np.random.Generator, name: str) -> Any:
        """Return a value for an option, nearly half of the time such as it takes."""
        kind = self.options[name].type if name in self.options else None
        if rng.random() < 0.6 or kind is None:
            return NASTY[rng.integers(len(NASTY))]
        if hasattr(kind, "choices"):
            return str(list(kind.choices)[rng.integers(len(kind.choices))])
        if getattr(self.options[name], "is_flag", False):
            return bool(rng.random() < 0.5)
        if name == "output":
            return ["out.gif", "out.png", ["out.npz", "out2.html"], "out"][rng.integers(4)]
        if kind.name == "integer":
            return int(rng.integers(1, 9))
        if kind.name == "float":
            return float(np.round(rng.random(), 3))
        return WORDS[rng.integers(len(WORDS))]

    def _settings(self, rng: np.random.Generator) -> dict[str, Any]:
        names = [*self.options, "unknown", "images", "", "Blur", "clmorph"]
        chosen = rng.choice(names, int(rng.integers(0, 5)), replace=False)
        settings = {str(name): self._value(rng, str(name)) for name in chosen}
        return {
            name.replace("_", "-") if rng.random() < 0.5 else name: value
            for name, value in settings.items()
        }

    def _toml(self, rng: np.random.Generator) -> tuple[str, bytes]:
        """Return settings, half of the time damaged."""
        settings = {"images": ["a.png", "b.png"]} | self._settings(rng)
        try:
            data = tomli_w.dumps(settings).encode("utf-8", "surrogatepass")
        except (TypeError, ValueError):  # what TOML does not have, such as None
            data = repr(settings).encode("utf-8", "replace")
        if rng.random() < 0.5:
            data = mutated(rng, data, b'[[a]]\nb = {c = 1}\n"\\u0000" = """')
        return "in.toml", data

    def _told(self, rng: np.random.Generator) -> dict[str, Any]:
        """Return the parameters of a file, some of them others."""
        told = json.loads(json.dumps(self.told))
        kind = int(rng.integers(4))
        if kind == 0:
            told["options"] |= self._settings(rng)
        elif kind == 1:
            name = str(rng.choice(["options", "images", "device", "clmorph", "morphs"]))
            told[name] = NASTY[rng.integers(len(NASTY))]
        elif kind == 2:
            image = told["images"][rng.integers(len(told["images"]))]
            image[str(rng.choice(["file", "sha256", "more"]))] = NASTY[rng.integers(len(NASTY))]
        else:
            del told[str(rng.choice(list(told)))]
        return dict(told)

    def _recipe(self, rng: np.random.Generator) -> tuple[str, bytes]:
        """Return a recipe, half of the time damaged."""
        data = json.dumps(self._told(rng)).encode()
        if rng.random() < 0.03:
            data = b'{"clmorph": ' + b"[" * 100_000
        elif rng.random() < 0.5:
            data = mutated(rng, data, b'{"a": [1, {}]}')
        return "in.json", data

    def _damaged_file(self, rng: np.random.Generator) -> tuple[str, bytes]:
        kind = str(rng.choice(list(self.written)))
        other = self.written[str(rng.choice(list(self.written)))]
        return f"in.{kind}", mutated(rng, self.written[kind], other)

    def _embedded(self, rng: np.random.Generator) -> tuple[str, bytes]:
        """Return a whole file with other parameters in it, some of which are no JSON."""
        text = json.dumps(self._told(rng))
        if rng.random() < 0.3:
            text = mutated(rng, text.encode(), b'{"a": 1}').decode("latin-1")
        kind = str(rng.choice(["gif", "png", "webp", "html", "npz"]))
        stream = BytesIO()
        picture = Image.new("RGB", (4, 4))
        if kind == "gif":
            picture.save(stream, "GIF", comment=text.encode("utf-8", "replace"))
        elif kind == "png":
            info = PngInfo()
            info.add_text("clmorph", text, zip=bool(rng.random() < 0.5))
            picture.save(stream, "PNG", pnginfo=info)
        elif kind == "webp":
            exif = Image.Exif()
            exif[0x010E] = text
            picture.save(stream, "WEBP", exif=exif)
        elif kind == "npz":
            np.savez(stream, parameters=np.array(text))
        else:
            page, mark = self.written["html"], json.dumps(self.told)[:12].encode()
            start = page.find(mark)
            end = page.find(b"</script>", start)
            stream.write(page[:start] + text.encode("utf-8", "replace") + page[end:])
        return f"in.{kind}", stream.getvalue()

    # How it is judged.

    def run(self, name: str, data: bytes, arguments: list[str]) -> list[str]:
        """Run the command, and return what is wrong with that."""
        (self.folder / name).write_bytes(data)
        before, outside = self._files(), _around(self.folder)
        began = time.monotonic()
        found: list[str] = []
        with Quiet() as printed:
            code: Any = None
            try:
                code = main(arguments)
            except BaseException as error:
                found.append(f"{type(error).__name__}: {error}")
        taken = time.monotonic() - began
        text = printed.text()
        if code is not None:
            found += _faults(code, text)
        if "not enough memory" in text or "does not fit into memory" in text:
            found.append("too much memory")
        if taken > PATIENCE:
            found.append(f"{taken:.1f} s")
        # What is named in a file of settings may begin with "out" only, see `_value`.
        more = self._files() - before
        strange = [file for file in more if not file.startswith("out")]
        if strange or (code != 0 and more) or _around(self.folder) != outside:
            found.append(f"files written: {sorted(more)}")
        for file in [*more, name]:
            (self.folder / file).unlink(missing_ok=True)
        for place in self.folder.iterdir():
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()
        return found

    def _files(self) -> set[str]:
        files = (file for file in self.folder.rglob("*") if file.is_file())
        return {str(file.relative_to(self.folder)) for file in files}


#: Options of the runs that make files to be damaged.
SMALL = ("--size", "6", "--frames", "3", "--max-iter", "30")


def _around(folder: Path) -> list[str]:
    """Return what lies beside the folder of the runs and is named like what they write."""
    return sorted(file.name for file in folder.parent.glob("out*"))


def _faults(code: Any, text: str) -> list[str]:
    """Return what is wrong with an exit code, and with what was printed to stderr."""
    lines = [line for line in text.splitlines() if not line.startswith(REMARKS)]
    errors = [line for line in lines if line.startswith("clmorph: error:")]
    found = []
    if code not in (0, 2):
        found.append(f"exit code {code}: {text[-300:]!r}")
    if "Traceback" in text:
        found.append(f"traceback: {text[-300:]!r}")
    if code == 2 and (len(errors) != 1 or len(lines) != 1):
        found.append(f"{len(lines)} lines of error: {text[:400]!r}")
    if code == 0 and lines:
        found.append(f"lines beside the output: {lines!r}"[:400])
    for line in errors:
        if not line.isprintable() or len(line) > LONGEST:
            found.append(f"not a short printable line: {line!r}"[:400])
    return found
