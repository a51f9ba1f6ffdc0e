"""Files that ``init`` writes name themselves as they were called."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.commands import ppmcal

from ppmcal.io.templates import find_template, for_editors, templates


@pytest.mark.parametrize("kind", sorted(templates()))
def test_the_commands_in_a_file_name_it_as_it_is_called(kind: str) -> None:
    path = find_template(kind)
    for file, schema in ((path, "mechanism"), (path.parent / "scenarios" / path.name, "scenario")):
        if file.exists():
            text = for_editors(file, schema, "stage")
            assert f"{path.stem}.yaml" not in text and f"{path.stem}.scenario.yaml" not in text


def test_init_writes_them_so(tmp_path: Path) -> None:
    ppmcal("init", "3-RPR", "--out", "stage.yaml", cwd=tmp_path, expect=0)
    assert "ppmcal check stage.yaml" in (tmp_path / "stage.yaml").read_text("utf-8")
    assert "stage.yaml stage.scenario.yaml" in (tmp_path / "stage.scenario.yaml").read_text("utf-8")


def test_a_name_that_a_comment_cannot_hold_spoils_no_file() -> None:
    path = find_template("3-RPR")
    lines = for_editors(path, "mechanism", "line\nbreak").splitlines()
    assert lines[1:] == path.read_text("utf-8").splitlines()
