"""The requests of the page."""

import asyncio
import json
import secrets
import warnings
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from clmorph._shared.printable import MESSAGE, printable, size_text
from clmorph.errors import ClmorphError, FileError, ImageWarning, InputError
from clmorph.images.pixels import fit, read_visible, to_bytes
from clmorph.pipeline.options import MorphOptions
from clmorph.studio import choices, work
from clmorph.studio.guard import FRAMED
from clmorph.studio.kinds import KINDS, MAX_PICTURES, MIN_PICTURES, PAINTED, painted_name
from clmorph.studio.painting import read_painted
from clmorph.studio.tabs import Shown, Tab, Tabs
from clmorph.studio.worker import Job, Worker

#: Largest numbers of bytes of a picture's file, and of a request of another kind.
MAX_UPLOAD, MAX_REQUEST = 64 << 20, 1 << 18
#: Longer side of a picture as the page shows it.
SHOWN_SIDE = 640
#: Longer side of a picture that is enlarged under its landmarks.
LARGE_SIDE = 2560
#: Seconds after which a silent stream says that it is alive.
ALIVE = 15.0
#: Files of the page by their addresses.
PAGE = {
    "/": ("studio.html", "text/html"),
    "/studio.css": ("studio.css", "text/css"),
    **{
        f"/{name}.js": (f"{name}.js", "text/javascript")
        for name in ("studio", "landmarks", "brush", "compare")
    },
}
#: Media types of what the page shows.
MEDIA = {".html": "text/html", ".png": "image/png"}
GONE = "this tab has been closed; load the page again"
NOTHING = "there is no such thing here"


class MissingError(Exception):
    """What is asked for is not there; the request is answered by its line."""


@dataclass
class Studio:
    """What all requests share."""

    #: The temporary folder.
    folder: Path
    worker: Worker
    #: How the command line says an error.
    line_of: work.LineOf
    #: Pictures to begin with.
    samples: list[Path]
    #: What the page says of each device: ``name``, ``label``.
    devices: list[dict[str, str]]

    def __post_init__(self) -> None:
        self.tabs = Tabs(
            self.folder, lambda key: self.worker.cancel(key, ("preview", "run", "save"))
        )

    def line(self, error: ClmorphError) -> str:
        """Return an error's line, without the temporary folder."""
        text = self.line_of(error)
        for tab in self.folder.iterdir():
            if str(tab) in text:
                head, _, rest = text.partition(f"{tab}/")
                text = head + rest.partition("/")[2]
        return text

    def app(self) -> Starlette:
        """Return the application."""
        tab = "/tabs/{tab}"
        post, got = ["POST"], ["GET"]
        routes = [
            *(Route(address, partial(_page, *PAGE[address]), methods=got) for address in PAGE),
            Route("/tabs", self._asked(self.open, of_tab=False), methods=post),
            *(
                Route(tab + path, self._asked(action), methods=methods)
                for path, action, methods in (
                    ("/leave", self.leave, post),
                    ("/found", self.found, post),
                    ("/events", self.events, got),
                    ("/pictures", self.add, post),
                    ("/samples", self.add_samples, post),
                    ("/pictures/{key}", self.picture, got),
                    ("/pictures/{key}/remove", self.remove, post),
                    ("/pictures/{key}/painted/{kind}", self.paint, post),
                    ("/pictures/{key}/painted/{kind}", self.painted, got),
                    ("/pictures/{key}/shown", self.shown, got),
                    ("/pictures/{key}/large", self.large, got),
                    ("/swap", self.swap, post),
                    ("/preview", partial(self.start, "preview"), post),
                    ("/run", partial(self.start, "run"), post),
                    ("/cancel", self.cancel, post),
                    ("/views/{name}", self.view, got),
                    ("/files/{ending}", self.file, got),
                    ("/still", self.still, got),
                )
            ),
        ]
        return Starlette(routes=routes)

    def _asked(
        self, action: Callable[..., Awaitable[Response]], of_tab: bool = True
    ) -> Callable[[Request], Awaitable[Response]]:
        """Let an action, perhaps of a tab, answer requests; its errors are answers, too."""

        async def answer(request: Request) -> Response:
            try:
                if not of_tab:
                    return await action(request)
                tab = self.tabs.find(request.path_params["tab"])
                if tab is None:
                    raise MissingError(GONE)
                return await action(request, tab)
            except ClmorphError as error:
                line = printable(self.line(error), MESSAGE)
            except ClientDisconnect:
                line = "the page has gone"
            except MissingError as error:
                return JSONResponse({"line": error.args[0]}, 404)
            except MemoryError:
                line = "not enough memory; use a smaller picture"
            return JSONResponse({"line": line}, 400)

        return answer

    async def open(self, request: Request) -> Response:
        """Open a tab, or that of a page that is loaded again, and describe the controls."""
        tab = self.tabs.find(request.query_params.get("again", "")) or self.tabs.open()
        kinds = [kind.described() for kind in KINDS.values()]
        return JSONResponse(
            {
                "tab": tab.key, "devices": self.devices, "kinds": kinds, "result": tab.told,
                "pictures": [picture.known for picture in tab.pictures],
            }
        )  # fmt: skip

    async def leave(self, request: Request, tab: Tab) -> Response:
        """Note that the page goes; its tab is closed unless it comes again soon."""
        self.tabs.leave(tab)
        return Response(status_code=204)

    async def found(self, request: Request, tab: Tab) -> Response:
        """Return the landmarks that are found in two pictures."""
        if len(tab.pictures) != 2:
            raise InputError(f"{len(tab.pictures)} pictures given: expected 2")
        ask = work.Ask(tab, tuple(tab.pictures), choices.Choices(KINDS["morph"]), 0)
        guide = await run_in_threadpool(ask.guide, MorphOptions())
        return JSONResponse({"pairs": guide.each[0], "text": guide.found})

    async def events(self, request: Request, tab: Tab) -> Response:
        """Stream what happens to a tab (server-sent events)."""
        return StreamingResponse(_stream(tab), media_type="text/event-stream")

    async def add(self, request: Request, tab: Tab) -> Response:
        """Take a picture's file, the body of the request."""
        self._room(tab, 1)
        path = tab.place(request.query_params.get("name", "picture"))
        too_large = FileError(
            f"{path.name}: more than {size_text(MAX_UPLOAD)}; expected a smaller file"
        )
        if int(request.headers.get("content-length", "0") or 0) > MAX_UPLOAD:
            return JSONResponse({"line": self.line(too_large)}, 413)
        size = 0
        try:
            with path.open("wb") as file:
                async for part in request.stream():
                    size += len(part)
                    if size > MAX_UPLOAD:
                        raise too_large
                    file.write(part)
            picture = await run_in_threadpool(_read, path)
        except FileError as error:
            path.unlink(missing_ok=True)
            return JSONResponse(
                {"line": printable(self.line(error), MESSAGE)}, 413 if error is too_large else 400
            )
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        self._room(tab, 1)
        tab.pictures.append(picture)
        return _pictures(tab)

    async def add_samples(self, request: Request, tab: Tab) -> Response:
        """Take the bundled pictures."""
        self._room(tab, len(self.samples))
        for sample in self.samples:
            path = tab.place(sample.name)
            path.write_bytes(sample.read_bytes())
            tab.pictures.append(await run_in_threadpool(_read, path))
        return _pictures(tab)

    def _room(self, tab: Tab, more: int) -> None:
        if len(tab.pictures) + more > MAX_PICTURES:
            raise InputError(f"a tab holds at most {MAX_PICTURES} pictures: remove one")

    async def picture(self, request: Request, tab: Tab) -> Response:
        """Return a picture's file as it was given."""
        path = _find(tab, request).path
        return _attached(path, path.name)

    async def shown(self, request: Request, tab: Tab) -> Response:
        """Return a picture as the page shows it."""
        return FileResponse(f"{_find(tab, request).path}.png-shown")

    async def large(self, request: Request, tab: Tab) -> Response:
        """Return a picture as the page enlarges it."""
        found = _find(tab, request)
        path = Path(f"{found.path}.png-large")
        if not path.exists():
            await run_in_threadpool(_show, found.pixels, path, LARGE_SIDE)
        return FileResponse(path)

    async def remove(self, request: Request, tab: Tab) -> Response:
        """Forget a picture."""
        tab.pictures = [each for each in tab.pictures if each.key != request.path_params["key"]]
        return _pictures(tab)

    async def paint(self, request: Request, tab: Tab) -> Response:
        """Take the painted regions of a picture, a PNG; without a body there are none any more."""
        found, kind = _find(tab, request), request.path_params["kind"]
        if kind not in PAINTED:
            raise MissingError(NOTHING)
        body = await _body(request, MAX_UPLOAD)
        if not body:
            found.painted.pop(kind, None)
        else:
            height, width = found.pixels.shape[:2]
            image = await run_in_threadpool(read_painted, body, (height, width), kind)
            # Each version has a folder of its own: work that waits or runs reads an older one.
            folder = found.path.parent / secrets.token_hex(8)
            folder.mkdir()
            path = folder / painted_name(kind, found.path.name)
            image.save(path, "PNG")
            found.painted[kind] = path
        return _pictures(tab)

    async def painted(self, request: Request, tab: Tab) -> Response:
        """Return the painted regions of a picture."""
        path = _find(tab, request).painted.get(request.path_params["kind"])
        if path is None:
            raise MissingError(NOTHING)
        return _attached(path, path.name)

    async def swap(self, request: Request, tab: Tab) -> Response:
        """Turn the order of the pictures round."""
        tab.pictures = tab.pictures[::-1]
        return _pictures(tab)

    async def start(self, kind: Any, request: Request, tab: Tab) -> Response:
        """Begin a preview or a whole morph, and say with which options."""
        async with tab.turn:
            return await self._start(kind, await _json(request), tab)

    async def _start(self, kind: Any, asked: Mapping[str, Any], tab: Tab) -> Response:
        number = asked.get("number")
        if not isinstance(number, int) or not 0 <= number < 1 << 40:
            raise InputError("number: expected the number of the request")
        chosen = choices.read_choices(asked)
        if chosen.device not in {device["name"] for device in self.devices}:
            raise InputError("device: expected one of those that the page offers")
        own, count = chosen.kind, len(tab.pictures)
        if not MIN_PICTURES <= count <= own.most:
            wanted = f"{MIN_PICTURES} to {own.most}" if own.most > MIN_PICTURES else str(own.most)
            raise InputError(f"{count} pictures given: expected {wanted}")
        guides = {"landmarks": chosen.given.get("landmarks"), "painted regions": chosen.painted}
        for name, given in guides.items():
            if count > 2 and given:
                raise InputError(
                    f"{name} are for two pictures, but {count} are given: morph them two at a time"
                )
        painted: list[Path] = []
        if chosen.painted:
            pictures = tab.pictures[: PAINTED[own.painted]]
            found = [each.painted.get(own.painted) for each in pictures]
            painted = [path for path in found if path is not None]
            if len(painted) < len(pictures):
                raise InputError("painted regions: expected at least one on each picture")
        ask = work.Ask(tab, tuple(tab.pictures), chosen, number, tuple(painted))
        preset = await run_in_threadpool(ask.recognized)
        chosen = choices.with_reach(chosen, preset)
        ask = replace(ask, choices=chosen)
        options = await run_in_threadpool(ask.options, preset)
        failed = partial(tab.publish, "error", number=number, of=kind)
        what = partial(work.run if kind == "run" else work.preview, ask)
        job = Job(
            tab.key, kind,
            partial(work.guarded, what, lambda line: failed(line=line), self.line),
            partial(tab.publish, "cancelled", number=number, of=kind),
        )  # fmt: skip
        before = self.worker.submit(job, ("preview", "run") if kind == "run" else ("preview",))
        return JSONResponse(
            {
                "options": options.outside(), "preset": chosen.named(preset), "before": before,
                **ask.words(preset),
            },
            202,
        )  # fmt: skip

    async def cancel(self, request: Request, tab: Tab) -> Response:
        """Request that the tab's work stops."""
        self.worker.cancel(tab.key, ("preview", "run", "save"))
        return Response(status_code=202)

    async def view(self, request: Request, tab: Tab) -> Response:
        """Return a viewer's page, which stands in a frame of the studio."""
        path = tab.views.get(request.path_params["name"])
        if path is None or not path.exists():
            raise MissingError(NOTHING)
        return FileResponse(
            path, media_type=MEDIA[path.suffix], headers={"Content-Security-Policy": FRAMED}
        )

    async def file(self, request: Request, tab: Tab) -> Response:
        """Write a file of the last run, and return it."""
        ending, result = request.path_params["ending"], tab.result
        if all(ending not in kind.downloads for kind in KINDS.values()):
            raise MissingError(NOTHING)
        if result is None:
            raise InputError("there is nothing to download yet: run it first")
        kind = result.choices.kind
        if ending not in kind.downloads:
            raise MissingError(NOTHING)
        path = tab.folder / f"{kind.output}-{result.number}.{ending}"
        write = partial(work.write_file, result, path, work.checking)
        return await self._written(tab, path, f"{kind.output}.{ending}", write)

    async def still(self, request: Request, tab: Tab) -> Response:
        """Write the frame of the last film at a time, and return it."""
        result = tab.result
        if result is None or not result.choices.kind.film:
            raise InputError("there is no film yet from which a still could be taken: run it first")
        time = _number(request, "time")
        path = tab.folder / f"still-{result.number}-{time:.4f}.png"
        write = partial(work.write_still, result, time, path)
        return await self._written(tab, path, f"{result.choices.kind.output}-{time:.2f}.png", write)

    async def _written(
        self, tab: Tab, path: Path, name: str, write_it: Callable[[], None]
    ) -> Response:
        """Return a file, which the worker writes unless it is there."""
        done: asyncio.Future[str] = asyncio.get_running_loop().create_future()

        def tell(line: str) -> None:
            with suppress(RuntimeError):  # the server has ended
                tab.loop.call_soon_threadsafe(_settle, done, line)

        def write() -> None:
            if not path.exists():
                write_it()
            tell("")

        guarded = partial(work.guarded, write, tell, self.line)
        self.worker.submit(Job(tab.key, "save", guarded, lambda: tell("cancelled")))
        line = await done
        if line:
            return JSONResponse({"line": line}, 400)
        return _attached(path, name)


def _number(request: Request, name: str) -> float:
    """Return a time of the query, at least 0."""
    text = request.query_params.get(name, "")
    try:
        found = float(text)
    except ValueError:
        found = -1.0
    if not 0.0 <= found <= MAX_PICTURES:
        raise InputError(f"{name}={printable(text, 40)}: expected a time of the film, from 0")
    return found


def _settle(done: "asyncio.Future[str]", line: str) -> None:
    if not done.done():
        done.set_result(line)


async def _page(name: str, kind: str, request: Request) -> Response:
    return Response(files("clmorph.studio.page").joinpath(name).read_bytes(), media_type=kind)


def _read(path: Path) -> Shown:
    """Read a picture, and write what the page shows of it."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ImageWarning)
        pixels = read_visible(path)
    _show(pixels, Path(f"{path}.png-shown"), SHOWN_SIDE)
    notes = tuple(str(each.message).replace(str(path), path.name) for each in found)
    return Shown(path, pixels, path.parent.name, notes=notes)


def _show(pixels: Any, path: Path, side: int) -> None:
    """Write a picture as the page shows it."""
    small = to_bytes(fit(pixels, side))
    Image.fromarray(np.ascontiguousarray(small)).save(path, "PNG")


def _find(tab: Tab, request: Request) -> Shown:
    for each in tab.pictures:
        if each.key == request.path_params["key"]:
            return each
    raise MissingError(NOTHING)


def _pictures(tab: Tab) -> Response:
    return JSONResponse({"pictures": [picture.known for picture in tab.pictures]})


def _attached(path: Path, name: str) -> Response:
    return FileResponse(path, media_type="application/octet-stream", filename=name)


async def _body(request: Request, most: int) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > most:
            raise InputError(f"the request has more than {most} bytes: expected fewer")
    return body


async def _json(request: Request) -> Mapping[str, Any]:
    body = await _body(request, MAX_REQUEST)
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError("the request: expected an object of JSON")
    return found


async def _stream(tab: Tab) -> AsyncIterator[str]:
    queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
    tab.listeners.add(queue)
    try:
        yield ": here\n\n"
        while True:
            try:
                message = await asyncio.wait_for(queue.get(), ALIVE)
            except TimeoutError:
                yield ": alive\n\n"
                continue
            yield f"data: {json.dumps(message)}\n\n"
    finally:
        tab.listeners.discard(queue)
