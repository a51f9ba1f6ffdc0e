"""Write docs/strangers-path.md: the stranger's way, then each mistake with answer and time."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from generators.mistakes import STRANGER, sections
from generators.pages import WHOLE, own_process, perform, steps, with_output
from generators.paths import DOCS

SHOWN = {"mine.yaml": "yaml", "measure.py": "python", "run1.yaml": "yaml", "targets.csv": "csv"}


def page() -> str:
    """Return the page, with what the program answers now and how long it took."""
    text = (STRANGER / "page.md").read_text(encoding="utf-8")
    for name, language in SHOWN.items():
        own = (STRANGER / name).read_text(encoding="utf-8")
        text = text.replace(f"<!-- file: {name} -->",
                            f'```{language} title="{name}"\n{own}```')
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "way").mkdir()
        (folder / "timed").mkdir()
        text = with_output(text, folder / "way")
        text = text.replace("<!-- times -->", times(text, folder / "timed"))
        return text.replace("<!-- mistakes -->", sections(own_process, folder))


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
    assert (STRANGER / "page.md").read_text(encoding="utf-8").startswith(WHOLE)
    (DOCS / "strangers-path.md").write_text(page(), encoding="utf-8")
