"""Write anew what the commands of the guides print: ``python docs/refresh.py [PAGE ...]``."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from generators.pages import WHOLE, with_output
from generators.paths import DOCS, ROOT

if __name__ == "__main__":
    named = [Path(p) for p in sys.argv[1:]] or [
        *sorted(DOCS.glob("*.md")), *sorted((ROOT / "examples").glob("*.md"))]
    for path in named:
        page = path.read_text(encoding="utf-8")
        # the stranger's path is written whole
        if page.startswith(WHOLE) and path.name != "strangers-path.md":
            with tempfile.TemporaryDirectory() as folder:
                shutil.copytree(ROOT / "sample_data", Path(folder) / "sample_data")
                path.write_text(with_output(page, Path(folder)), encoding="utf-8")
            print(path.name)
