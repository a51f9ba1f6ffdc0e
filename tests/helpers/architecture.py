"""The page about how the program is built, by its sections."""

import re

from helpers.paths import ROOT

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def section(title):
    """Return what stands under a heading of the page."""
    return re.search(rf"^## {re.escape(title)}$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)[1]


def block(title, language="python"):
    """Return the fenced block of a section."""
    return re.search(rf"^```{language}\n(.*?)^```", section(title), re.M | re.S)[1]
