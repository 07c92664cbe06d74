"""Drive the system's Chromium."""

from contextlib import contextmanager

import pytest
from programs import program

#: Milliseconds that a slow machine may take to start, to load a page, or to make a file.
PATIENCE = 120_000
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip


@contextmanager
def chromium():
    """Start a browser; the test is skipped if there is none, and fails if one is required."""
    path = program("chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=FLAGS, timeout=PATIENCE)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@contextmanager
def watched(browser):
    """Yield a function that opens pages in contexts of their own, and a list of what goes wrong.

    A page may ask for nothing but addresses that begin with one of `own`. At the end the contexts
    are closed.
    """
    bad, contexts = [], []

    def answered(dialog):
        # A page may ask whether it is to be left.
        if dialog.type == "beforeunload":
            dialog.accept()
        else:
            bad.append(dialog.message)

    def open_page(address, own, before="", **options):
        context = browser.new_context(**({"reduced_motion": "reduce"} | options))
        context.set_default_timeout(PATIENCE)
        contexts.append(context)
        page = context.new_page()
        page.add_init_script(before)
        page.on("console", lambda message: bad.append(message.text))
        page.on("pageerror", lambda error: bad.append(str(error)))
        page.on("dialog", answered)

        def asked(request):
            if not request.url.startswith((*own, "data:", "blob:", "about:srcdoc")):
                bad.append(request.url)

        page.on("request", asked)
        page.goto(address)
        return page

    yield open_page, bad
    for context in contexts:
        context.close()
