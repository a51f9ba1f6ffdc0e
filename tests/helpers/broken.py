"""Good files of `tests/broken`, with edits that break them."""

from pathlib import Path

from helpers.paths import ROOT

GOOD = ROOT / "tests" / "broken"


def edited(folder: Path, good: str, *edits: tuple[str, str], once: bool = False) -> Path:
    """Write a good file to a folder with the first of each (old, new) replaced.

    ``once``: the old text must stand at one place only. The name loses its ``good_``.
    """
    text = (GOOD / good).read_text(encoding="utf-8")
    for old, new in edits:
        assert old in text, f"nothing to edit: {old!r}"
        assert not once or text.count(old) == 1, f"the edit must hit one place: {old!r}"
        text = text.replace(old, new, 1)
    path = folder / good.removeprefix("good_")
    path.write_text(text, encoding="utf-8")
    return path
