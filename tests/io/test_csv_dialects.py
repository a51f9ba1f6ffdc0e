"""A CSV as spreadsheets write it holds the same numbers as the one with commas, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table, csv_table
from ppmcal.io.csv_dialect import Dialect

HEADER = ("pose", "q_leg1", "q_leg2", "x", "time")
DIALECTS = [Dialect(s, d) for s, d in ((",", "."), (";", "."), (";", ","), ("\t", "."),
                                       ("\t", ","))]
NUMBERS = np.random.default_rng(5).normal(size=(400, len(HEADER))) * 10.0 ** np.arange(-6, 9, 3)


def cells(labels: bool) -> list[list[str]]:
    """Return rows of text; some cells are empty, exponents occur, and labels if asked for."""
    out = [[f"{v:.17g}" for v in row] for row in NUMBERS]
    for i, row in enumerate(out):
        row[0] = f"P{i}" if labels else str(i)
        if i % 7 == 3:
            row[3] = ""
        if i % 11 == 5:
            row[4] = "nan"
    return out


def written(rows: list[list[str]], dialect: Dialect, header: tuple[str, ...] = HEADER) -> bytes:
    lines = [dialect.separator.join(header)]
    lines += [dialect.separator.join(c.replace(".", dialect.decimal) for c in r) for r in rows]
    return ("\n".join(lines) + "\n").encode()


def read(data: bytes) -> Table:
    return csv_table(data, "d.csv", lambda name: name in ("pose", "session"))


@pytest.mark.parametrize("labels", [False, True], ids=["fast", "careful"])
@pytest.mark.parametrize("dialect", DIALECTS, ids=str)
@pytest.mark.parametrize("dress", ["plain", "crlf", "bom", "declared", "quoted"])
def test_the_numbers_are_those_of_the_canonical_file(labels: bool, dialect: Dialect, dress: str
                                                     ) -> None:
    rows = cells(labels)
    expected = read(written(rows, Dialect()))
    data = written(rows, dialect)
    if dress == "crlf":
        data = data.replace(b"\n", b"\r\n")
    elif dress == "bom":
        data = b"\xef\xbb\xbf" + data
    elif dress == "declared":
        data = b"sep=" + dialect.separator.encode() + b"\n" + data
    elif dress == "quoted":
        quoted = [[f'"{c}"' for c in row] for row in rows]
        data = written(quoted, dialect, tuple(f'"{h}"' for h in HEADER))
    found = read(data)
    assert found.dialect == dialect
    assert found.header == expected.header and found.text == expected.text
    assert list(found.numbers) == list(expected.numbers)
    for name, values in expected.numbers.items():
        assert found.numbers[name].tobytes() == values.tobytes(), name
    np.testing.assert_array_equal(found.numbers["q_leg2"], NUMBERS[:, 2])


def test_two_million_characters_are_parsed_in_pieces_alike() -> None:
    rows = cells(False) * 80
    whole = written(rows, Dialect(";", ","))
    assert len(whole) > 1 << 21
    assert read(whole).numbers["x"].tobytes() == read(written(rows, Dialect())).numbers[
        "x"].tobytes()


def test_commas_in_words_are_no_decimal_marks() -> None:
    table = read(b"pose;x;session\nA, left;1.5;day 1.2\nB, right;2.25;day 2\n")
    assert table.numbers["x"].tolist() == [1.5, 2.25]
    assert table.text["pose"] == ("A, left", "B, right")
    assert table.dialect == Dialect(";", ".")


def test_a_header_may_hold_other_marks() -> None:
    assert read(b"x, left;y, right\n1,5;2,5\n").header == ("x, left", "y, right")
    assert read(b'"x; old",y\n1.5,2.5\n').header == ("x; old", "y")


@pytest.mark.parametrize(("data", "says"), [
    (b"x,y\n1,5,2,5\n", ["row 1", "decimal commas", "Save it"]),
    (b'x,y\n"1,5","2,5"\n', ["row 1, column x", "decimal point"]),
    (b"x;y\n1,5;2.5\n", ["row 1, column x ('1,5')", "row 1, column y ('2.5')", "one decimal mark"]),
    (b"x;y\n1;2\n1.234,5;2\n", ["row 2, column x", "thousands"]),
    (b"x;y\n1;2\n1,234,567;2\n", ["row 2, column x", "'1,234,567' is not a number"]),
    (b"x\ty\n1\t2\t3\n", ["row 1", "3 cells"]),
    (b"x;y\n1,2\n", ["header", "semicolons", "commas"]),
    (b"x,y\n1;2\n", ["row 1", "semicolons"]),
    (b"1,5;2,5\n3,5;4,5\n", ["header", "numbers, not column names"])])
def test_what_is_ambiguous_is_refused_with_the_mend(data: bytes, says: list[str]) -> None:
    with pytest.raises(BadInput, match=r"d\.csv") as refused:
        read(data)
    for words in says:
        assert words in str(refused.value)
