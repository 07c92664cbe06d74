"""Turn a folder of device reports into a Markdown table.

    clmorph check --all --report reports/mine.json
    python tools/vendor_matrix.py reports

A report is what ``clmorph check --report`` writes: one bundle, or a list of them.
"""

import json
import sys
from pathlib import Path
from typing import Any


def bundles(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for file in sorted(folder.glob("*.json")):
        content = json.loads(file.read_text())
        found += content if isinstance(content, list) else [content]
    return found


def row(bundle: dict[str, Any]) -> str:
    device = bundle["device"]
    failed = [finding["name"] for finding in bundle["findings"] if not finding["passed"]]
    worst = max((finding["share"] for finding in bundle["findings"] if not failed), default=0.0)
    verdict = f"fails: {', '.join(failed)}" if failed else f"pass ({worst:.0%} of the tolerance)"
    return " | ".join([
        f"| {device['name']}", f"{device['platform']}, {device['driver']}", device["kind"],
        bundle["system"], "yes" if device["float64"] else "no",
        ", ".join(device["quirks"]) or "none", f"{bundle['pairs_per_second'] / 1e9:.1f}",
        f"{verdict}, clmorph {bundle['clmorph']} |",
    ])  # fmt: skip


def table(folder: Path) -> str:
    lines = [
        "| device | platform, driver | type | system | float64 | quirks | 10⁹ pairs/s | check |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(lines + [row(bundle) for bundle in bundles(folder)])


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        print("usage: python tools/vendor_matrix.py FOLDER_OF_REPORTS", file=sys.stderr)
        raise SystemExit(2)
    print(table(Path(sys.argv[1])))
