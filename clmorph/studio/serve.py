"""Start the studio's server, and end it without leaving anything."""

import ipaddress
import secrets
import socket
import tempfile
import threading
import time
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from clmorph._shared.printable import reason_of
from clmorph._shared.signals import note_partial
from clmorph._shared.staging import staging_folder
from clmorph.backends.opencl.devices.find import find_devices
from clmorph.backends.select import get_backend
from clmorph.errors import InputError, OutputError
from clmorph.studio.work import LineOf

#: Port at which the studio listens unless told otherwise.
PORT = 8017
#: Seconds for which running work may delay the end.
PATIENCE = 3.0


def need_studio() -> None:
    """Raise an error that says what to install if the extra ``studio`` is missing."""
    if any(find_spec(name) is None for name in ("starlette", "uvicorn")):
        raise InputError('the studio needs the extra "studio": pip install "clmorph[studio]"')


def serve(
    host: str,
    port: int | None,
    *,
    device: str,
    browser: bool,
    samples: Callable[[Path], list[Path]],
    line_of: LineOf,
    say: Callable[[str], None],
) -> None:
    """Serve the page until a signal ends the process.

    Unless `host` is a loopback address, a token is needed. With `port` None it listens at `PORT`,
    or a free port if that is taken, and with 0 at a free port. `samples` writes the bundled
    pictures to a folder, and `line_of` tells how an error is said.
    """
    need_studio()
    import uvicorn

    from clmorph.studio.guard import TOKEN, Access, Guard
    from clmorph.studio.routes import Studio
    from clmorph.studio.worker import Worker

    listening = _listen(host, port)
    taken = listening.getsockname()[1]
    token = "" if _is_loopback(host) else secrets.token_urlsafe(24)
    home = Path(tempfile.gettempdir()).resolve()
    note_partial("the studio has ended")
    try:
        with listening, staging_folder(home) as folder:
            tabs = folder / "tabs"
            tabs.mkdir()
            worker = Worker()
            studio = Studio(tabs, worker, line_of, samples(folder), _devices(device))
            config = uvicorn.Config(
                Guard(studio.app(), Access(host, taken, token)), log_level="critical",
                access_log=False, lifespan="off", server_header=False, date_header=False,
                ws="none", timeout_graceful_shutdown=1, proxy_headers=False,
                limit_concurrency=256,
            )  # fmt: skip
            server = uvicorn.Server(config)
            thread = threading.Thread(
                target=server.run, args=([listening],), name="clmorph-server", daemon=True
            )
            try:
                thread.start()
                address = _address(host, taken) + (f"?{TOKEN}={token}" if token else "")
                while not server.started and thread.is_alive():
                    time.sleep(0.01)
                say(f"the studio is at {address} (Ctrl-C ends it)")
                if browser:
                    with suppress(webbrowser.Error):
                        webbrowser.open(address)
                while thread.is_alive():
                    thread.join(0.2)
            finally:
                server.should_exit = True
                worker.close(PATIENCE)
                thread.join(PATIENCE)
    except OSError as error:
        raise OutputError(
            f"{home}: there is no usable temporary folder ({reason_of(error)})"
        ) from None


def _listen(host: str, port: int | None) -> socket.socket:
    """Return a listening socket."""
    try:
        kind, *_, place = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        raise InputError(
            f"host {host}: expected an address or a name ({reason_of(error)})"
        ) from None
    tries = (PORT, 0) if port is None else (port,)
    for number in tries:
        found = socket.socket(kind, socket.SOCK_STREAM)
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((place[0], number, *place[2:]))
            found.listen(128)
        except OSError as error:
            found.close()
            if number == tries[-1]:
                raise InputError(
                    f"port {number}: cannot listen there ({reason_of(error)}); choose another "
                    "one, or 0 for any"
                ) from None
            continue
        return found
    raise AssertionError


def _is_loopback(host: str) -> bool:
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _address(host: str, port: int) -> str:
    shown = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{shown}:{port}/"


def _devices(first: str) -> list[dict[str, str]]:
    """Return the devices for the page, each with its name and its measured speed."""
    operations = get_backend(first)
    label = f"{first}: {operations.description}{_speed(operations.pairs_per_second)}"
    usual = [{"name": first, "label": label}]
    found = [
        {
            "name": device.index,
            "label": f"{device.name} ({device.platform}){_speed(device.pairs_per_second)}",
        }
        for device in find_devices()
        if device.usable
    ]
    numpy = [{"name": "numpy", "label": "NumPy (slow, for checking)"}]
    return usual + [each for each in found + numpy if each["name"] != first]


def _speed(pairs_per_second: float) -> str:
    """Return a measured speed as the end of a label; "" if there is none."""
    return f": {pairs_per_second / 1e9:.2g} · 10⁹ pairs/s" if pairs_per_second else ""
