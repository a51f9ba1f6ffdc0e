"""The notebook as a page: its cells, which a test runs."""

from __future__ import annotations

import json
from pathlib import Path

from generators.markdown import fenced


def notebook_page(path: Path) -> str:
    """Return a notebook's cells as Markdown; outputs are not kept in it."""
    out = []
    for kind, source in cells(path):
        out.append(source if kind == "markdown" else fenced(source, "python"))
    return "\n\n".join(out) + f"\n\nAs a notebook: [{path.name}]({path.name}).\n"


def cells(path: Path) -> list[tuple[str, str]]:
    """Return (``markdown`` or ``code``, text) of each cell."""
    content = json.loads(path.read_text(encoding="utf-8"))
    return [(c["cell_type"], "".join(c["source"])) for c in content["cells"]]
