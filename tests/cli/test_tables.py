"""Tables of the console: 80 columns, names cut in the middle, numbers whole."""

from __future__ import annotations

import io
import json
import sys

import pytest
from rich.console import Console as Rich

from ppmcal.cli.common import WIDTH, Console, plain_table


def shown(*table: object) -> list[str]:
    out = io.StringIO()
    Rich(width=WIDTH, file=out).print(plain_table(*table))
    return out.getvalue().splitlines()


@pytest.mark.parametrize("name", ["leg1.offset", "hexapod.upper.leg12.platform.point.radius.x"])
@pytest.mark.parametrize("words", ["", "redundant", "possible, and more than can be said"])
def test_numbers_stay_whole(name: str, words: str) -> None:
    numbers = ["-0.0695764", "+0.32", "0.24", "1.234e-05"]
    lines = shown(["parameter", "new", "new - old", "+- 95 %", "by noise", "unit", ""],
                  [[name, *numbers, "mm", words]], (1, 2, 3, 4))
    assert max(map(len, lines)) <= WIDTH
    row = next(line for line in lines if "-0.0695764" in line)
    assert all(number in row.split() for number in numbers)
    cut = row.split()[0]
    assert cut == name or ("…" in cut and name.startswith(cut.partition("…")[0])
                           and name.endswith(cut.partition("…")[2]))


@pytest.mark.parametrize("name", ["run[b].csv", "a[/b]", ":smile:", "[link=x]y[/link]"])
def test_names_are_no_mark_up(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    Console(False, False).table(plain_table(["file", ""], [[name, "same"]]))
    assert name in capsys.readouterr().out


def test_names_steer_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console(False, False)
    console.say("bench\x1b[2J\u202e: 3 limbs\nand more")
    console.table(plain_table(["file"], [["\x1b]0;x\a"]]))
    out = capsys.readouterr().out
    assert "bench\\x1b[2J\\u202e: 3 limbs\nand more" in out
    assert "\\x1b]0;x\\x07" in out
    assert out.replace("\n", "").isprintable()


@pytest.mark.parametrize(("errors", "shown"), [
    ("strict", b"m\\udcff \\ud800.csv"), ("surrogateescape", b"m\xff \\ud800.csv")])
def test_names_that_are_no_utf8_can_be_said(errors: str, shown: bytes,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    name, held = "m\udcff \ud800.csv", io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(held, "utf-8", errors=errors))
    Console(False, False).say(f"Written: {name}")
    Console(False, False).table(plain_table(["file"], [[name]]))
    Console(False, True).summary({"written": name})
    sys.stdout.flush()
    said, _, summary = held.getvalue().partition(b"{")
    assert said.startswith(b"Written: " + shown) and said.count(shown) == 2
    assert json.loads(b"{" + summary) == {"written": name}


def test_a_table_without_rows() -> None:
    assert any("parameter" in line for line in shown(["parameter", "new"], [], (1,)))
