"""The pytest plugin that puts an adapter in place and counts clmorph's solves in each test.

It is told by environment variables, see `ADAPTER`, `REPORT` and `peers.bridge.DEVICE`.
"""

import importlib
import json
import os
import time
from pathlib import Path
from typing import Any

import pytest

from peers import bridge, reasons
from peers.outcomes import DECLINED

#: The adapter's name, of `peers.adapter_<name>`; empty: the library answers by itself.
ADAPTER = "CLMORPH_PEER_ADAPTER"
#: The library whose tests these are: a key of `peers.reasons.OUTSIDE`.
LIBRARY = "CLMORPH_PEER_LIBRARY"
#: The file that gets a line of JSON for each test.
REPORT = "CLMORPH_PEER_REPORT"
#: The module below `peers` with fixtures that a library's own conftest would bring.
FIXTURES = "CLMORPH_PEER_FIXTURES"


class Recorder:
    """Writes one line for each test, and one for each file that cannot be collected."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("a", encoding="utf-8")
        self._told: dict[str, Any] = {}

    def write(self, **told: Any) -> None:
        """Write a line."""
        print(json.dumps(told), file=self._file, flush=True)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
        """Count what one test calls."""
        bridge.TALLY.reset()
        self._told = {"test": item.nodeid, "outcome": "passed", "message": ""}
        began = time.monotonic()
        result = yield
        seconds = round(time.monotonic() - began, 2)
        if bridge.TALLY.declined:
            self._told |= {
                "outcome": "skipped", "message": DECLINED + bridge.TALLY.declined
            }  # fmt: skip
        self.write(**self._told, calls=bridge.TALLY.calls, seconds=seconds)
        return result

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Leave out what is about other problems, and say so."""
        library = os.environ[LIBRARY]
        left, out = [], []
        for item in items:
            reason = reasons.find(reasons.OUTSIDE[library], item.nodeid)
            (left if reason is None else out).append(item)
            if reason is not None:
                message = DECLINED + reason
                self.write(test=item.nodeid, outcome="skipped", message=message, calls=0)
        config.hook.pytest_deselected(items=out)
        items[:] = left

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the worst outcome of a test's three phases."""
        if report.failed:
            self._told |= {"outcome": "failed", "message": report.longreprtext[-4000:]}
        elif report.skipped and self._told["outcome"] == "passed":
            longrepr = report.longrepr
            reason = longrepr[2] if isinstance(longrepr, tuple) else report.longreprtext
            self._told |= {"outcome": "skipped", "message": reason.removeprefix("Skipped: ")}

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Tell what could not even be imported."""
        if report.failed:
            self.write(
                test=report.nodeid, outcome="failed", message=report.longreprtext[-4000:], calls=0
            )
        elif report.skipped:
            self.write(test=report.nodeid, outcome="skipped", message=str(report.longrepr), calls=0)


def pytest_configure(config: pytest.Config) -> None:
    """Put the adapter in place for the whole run."""
    if os.environ.get(FIXTURES):
        module = importlib.import_module(f"peers.{os.environ[FIXTURES]}")
        config.pluginmanager.register(module, "peer-fixtures")
        if hasattr(module, "prepare"):
            module.prepare(config)
    if os.environ.get(ADAPTER):
        adapter = importlib.import_module(f"peers.adapter_{os.environ[ADAPTER]}")
        stack = bridge.replaced(adapter.PACKAGE, adapter.replacements())
        stack.__enter__()
        config.add_cleanup(lambda: stack.__exit__(None, None, None))
    config.pluginmanager.register(Recorder(Path(os.environ[REPORT])), "peer-recorder")
