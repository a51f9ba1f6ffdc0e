"""Write docs/strangers-path.md: the stranger's way, then each mistake with answer and time.

And docs/three-paths.md: a stage, a hexapod and a printer against simulators of their own.
"""

from __future__ import annotations

import re
import sys
import tempfile
import time
from pathlib import Path

from generators.mistakes import STRANGER, sections
from generators.pages import WHOLE, own_process, perform, steps, with_output
from generators.paths import DOCS

PAGES = {"strangers-path.md": "page.md", "three-paths.md": "three.md"}
"""Of each page what it is made from."""
LANGUAGES = {".yaml": "yaml", ".py": "python", ".csv": "csv"}
FILE = re.compile(r"<!-- file: (\S+) -->")


def page(source: str) -> str:
    """Return a page, with what the program answers now and how long it took."""
    text = (STRANGER / source).read_text(encoding="utf-8")
    assert text.startswith(WHOLE)
    for name in FILE.findall(text):
        own = (STRANGER / name).read_text(encoding="utf-8")
        text = text.replace(f"<!-- file: {name} -->",
                            f'```{LANGUAGES[Path(name).suffix]} title="{name}"\n{own}```')
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "way").mkdir()
        (folder / "timed").mkdir()
        text = with_output(text, folder / "way")
        text = text.replace("<!-- times -->", times(text, folder / "timed"))
        if "<!-- mistakes -->" in text:
            text = text.replace("<!-- mistakes -->", sections(own_process, folder))
        return text


def times(text: str, folder: Path) -> str:
    """Return a table of the way's commands and the seconds that each took."""
    lines, total = ["| command | seconds |", "|---|---|"], 0.0
    for step in steps(text):
        began = time.perf_counter()
        perform(step, folder, own_process)
        seconds = time.perf_counter() - began
        if step.line.startswith(("ppmcal", "python")):
            total += seconds
            lines.append(f"| `{step.line}` | {seconds:.1f} |")
    return "\n".join([*lines, f"| all | {total:.0f} |"])


if __name__ == "__main__":
    for name in sys.argv[1:] or PAGES:
        (DOCS / name).write_text(page(PAGES[name]), encoding="utf-8")
