"""Lay out the guides: hand-written pages, and those made from the program itself.

``python docs/generate.py FOLDER`` fills a folder that the site generator turns into pages. What
follows from the program is made here and never committed: keys of files from their schemas,
commands from their help, Python functions from their docstrings, limb kinds and effects from their
registries, drawings from shipped machines, formulas as MathML.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from generators.api import api_page
from generators.commands import command_page
from generators.drawings import drawings
from generators.keys import key_pages
from generators.kinds import effect_sections, limb_page
from generators.limits import limits_table
from generators.mathml import with_formulas
from generators.notebook import notebook_page
from generators.paths import DOCS, ROOT

MARK = "<!-- generated: effects -->"
"""Where in effects.md the kinds stand one by one."""
LIMITS = "<!-- generated: limits -->"
"""Where in trust.md the limits stand."""


def pages() -> dict[str, str]:
    """Return path -> Markdown of every page of the site."""
    out = {path.name: path.read_text(encoding="utf-8") for path in sorted(DOCS.glob("*.md"))}
    out["effects.md"] = out["effects.md"].replace(MARK, effect_sections())
    out["trust.md"] = out["trust.md"].replace(LIMITS, limits_table())
    out["calibration.md"] = notebook_page(DOCS / "calibration.ipynb")
    out["changes.md"] = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    reference = {"commands.md": command_page(), "python.md": api_page(), "limbs.md": limb_page(),
                 **key_pages()}
    out |= {f"reference/{name}": text.replace("(images/", "(../images/").replace(
        "(calibration.md)", "(../calibration.md)") for name, text in reference.items()}
    return {name: with_formulas(text) for name, text in out.items()}


def lay_out(folder: Path) -> None:
    """Write all pages, drawings and pictures into a folder; what was there is replaced."""
    if folder.exists():
        shutil.rmtree(folder)
    for name, text in pages().items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    if (DOCS / "images").exists():
        shutil.copytree(DOCS / "images", folder / "images")
    for notebook in DOCS.glob("*.ipynb"):
        shutil.copy(notebook, folder)
    shutil.copytree(DOCS / "style", folder / "style")
    drawings(folder / "images" / "generated")


if __name__ == "__main__":
    lay_out(Path(sys.argv[1]))
