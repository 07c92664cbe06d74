"""The tabs: each has its pictures, its folder, its results, and listeners to what happens."""

import asyncio
import secrets
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clmorph._shared.printable import printable
from clmorph.errors import InputError
from clmorph.pipeline.guides import Guided
from clmorph.studio.choices import Choices
from clmorph.studio.kinds import KINDS, PAINTED, painted_ending
from clmorph.studio.making import Made

#: Largest number of tabs.
MAX_TABS = 16
#: Seconds after which a tab that nobody listens to is closed.
LEFT = 120.0
#: Seconds within which a page that is loaded again finds its tab.
RELOADED = 20.0
#: Largest number of characters of a picture's name.
MAX_NAME = 100


@dataclass(frozen=True)
class Shown:
    """A picture of a tab: its file, its pixels (H, W, C), and what the page knows of it."""

    path: Path
    pixels: Any = field(repr=False)
    key: str
    #: Files with its painted regions, by their kind ("labels", "mask").
    painted: dict[str, Path] = field(default_factory=dict)
    #: What reading the file has warned of.
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> dict[str, Any]:
        """The description for the page."""
        height, width = self.pixels.shape[:2]
        painted = {kind: path.name for kind, path in self.painted.items()}
        return {
            "key": self.key, "name": self.path.name, "width": width, "height": height,
            "painted": painted, "notes": list(self.notes),
        }  # fmt: skip


@dataclass(frozen=True)
class Result:
    """A finished run: what was made, and from what."""

    number: int
    made: Made
    parameters: dict[str, Any]
    choices: Choices


@dataclass(eq=False)
class Tab:
    """One page in one browser."""

    key: str
    folder: Path
    loop: asyncio.AbstractEventLoop
    pictures: list[Shown] = field(default_factory=list)
    views: dict[str, Path] = field(default_factory=dict)
    result: Result | None = None
    #: The message about `result`, for a page that is loaded again.
    told: dict[str, Any] | None = None
    #: The landmarks that were found last, by the pictures between which.
    found: dict[tuple[Any, ...], Guided] = field(default_factory=dict)
    heard: float = field(default_factory=time.monotonic)
    listeners: set["asyncio.Queue[dict[str, Any]]"] = field(default_factory=set)
    lock: threading.Lock = field(default_factory=threading.Lock)
    #: Requests for work begin one after another, so that an older one never replaces a newer one.
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)

    def publish(self, kind: str, **more: Any) -> None:
        """Tell the page something, from any thread."""
        try:
            self.loop.call_soon_threadsafe(self._tell, {"type": kind, **more})
        except RuntimeError:  # the server has ended
            return

    def _tell(self, message: dict[str, Any]) -> None:
        for queue in self.listeners:
            queue.put_nowait(message)

    def place(self, name: str) -> Path:
        """Return a path for a new picture, whose name is new without its ending too."""
        key = secrets.token_hex(8)
        folder = self.folder / key
        folder.mkdir()
        path = folder / safe_name(name)
        taken = {each.path.stem for each in self.pictures}
        taken |= {kind.output for kind in KINDS.values()}  # what the command writes
        endings = tuple(map(painted_ending, PAINTED))
        stem, number = path.stem, 2
        while path.stem in taken or path.stem.endswith(endings):
            path = path.with_stem(f"{stem}-{number}")
            number += 1
        return path

    def view(self, name: str, path: Path, keep: int = 2) -> str:
        """Let the page read a file; only the newest views of the name's kind are kept."""
        kind = name.split("-")[0]
        with self.lock:
            self.views[name] = path
            old = [other for other in self.views if other.split("-")[0] == kind][:-keep]
            for other in old:
                self.views.pop(other).unlink(missing_ok=True)
        return f"/tabs/{self.key}/views/{name}"


class Tabs:
    """All tabs; those that were left are closed."""

    def __init__(self, folder: Path, gone: Callable[[str], None]) -> None:
        self._folder, self._gone = folder, gone
        self._tabs: dict[str, Tab] = {}

    def open(self) -> Tab:
        """Open a tab, or raise InputError if there are too many."""
        self.sweep()
        if len(self._tabs) >= MAX_TABS:
            left = [tab for tab in self._tabs.values() if not tab.listeners]
            if left:
                self.close(min(left, key=lambda tab: tab.heard).key)
        if len(self._tabs) >= MAX_TABS:
            raise InputError(f"{MAX_TABS} tabs are open: expected fewer; close one")
        key = secrets.token_urlsafe(16)
        folder = self._folder / secrets.token_hex(8)
        folder.mkdir(mode=0o700)
        tab = self._tabs[key] = Tab(key, folder, asyncio.get_running_loop())
        return tab

    def find(self, key: str) -> Tab | None:
        """Return a tab, or None."""
        tab = self._tabs.get(key)
        if tab is not None:
            tab.heard = time.monotonic()
        return tab

    def close(self, key: str) -> None:
        """Close a tab: its work stops, and its files go."""
        tab = self._tabs.pop(key, None)
        if tab is not None:
            self._gone(key)
            shutil.rmtree(tab.folder, ignore_errors=True)

    def leave(self, tab: Tab) -> None:
        """Close a tab whose page has gone, unless it is loaded again soon."""

        def end() -> None:
            if not tab.listeners and self._tabs.get(tab.key) is tab:
                self.close(tab.key)

        tab.loop.call_later(RELOADED, end)

    def sweep(self) -> None:
        """Close the tabs that were left."""
        now = time.monotonic()
        for key, tab in list(self._tabs.items()):
            if not tab.listeners and now - tab.heard > LEFT:
                self.close(key)


def safe_name(name: str) -> str:
    """Return the last part of a file's name, without what could be a path or an option.

    Examples
    --------
    >>> safe_name("../../etc/passwd"), safe_name(".."), safe_name("a/b.png")
    ('passwd', 'picture', 'b.png')
    """
    last = printable(name.replace("\\", "/").rsplit("/", 1)[-1], 4 * MAX_NAME)
    last = "".join(letter for letter in last if letter.isprintable() and letter not in '<>:"|?*')
    last = last.strip(" .")
    stem, dot, ending = last.rpartition(".")
    if len(last) > MAX_NAME:
        last = (stem or ending)[: MAX_NAME - 10] + dot + ending[-8:]
    return last.strip(" .") or "picture"
