"""Inputs made from good ones: bytes, lines, numbers, cells and trees are changed or joined."""

import csv
import io
import json
import random
import re

import yaml

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
NUMBERS = ["nan", ".nan", ".inf", "-.inf", "inf", "1e400", "-1e400", "1e308", "1e154", "1e16",
           "1e15", "1e12", "1e-320", "1e-300", "0", "-0.0", "1", "-1", "2", "9" * 20, "9" * 400,
           "9" * 5000, "0x10", "1_000", "1,5", "1.5.2", "1e", "--1", "+1", ".5", "5.", "010",
           "1:30", "٣", "½"]
WORDS = ["", " ", "\t", "\n", "\r", "\r\n", "\x00", "\x1b[2J", "\ufeff", "\u2028", "\x85", "\ud800",
         "null", "~", "true", "no", "[]", "{}", "[", "{", "]", "}", '"', "'", "#", ":", ": ", "- ",
         "?", "|", ">", "%", "@", "`", "&a ", "*a", "<<: *a", "!!float ", "!!python/name:os.system",
         "---\n", "...\n", ",", ";", ",,", "=", "..", "../../x", "/dev/zero", "a/b", ".", "*",
         "x" * 300, "unknown", "known", "quat_w", "rz", "leg1", "setp", "[JOINT_0]", "#*#", "M665",
         "G31"]
LONG = 0.02
"""Part of the inputs that get a long run of one piece."""
PIECES = [bytes([c]) for c in b" \t\n0195aex_.,;:-+#\"'[]{}()&*!|>=@%"] + [
    b"11:", b"1.", b"1,", b", ", b"a ", b"- ", b"a:", b"::", b"[[", b"{a: ", b"\r\n", b"\n "]
TREES = [None, True, False, 0, -1, 1, 2, 0.5, -0.0, 1e16, -1e16, 1e154, 1e300, 1e-300, float("nan"),
         float("inf"), -float("inf"), 10 ** 20, 10 ** 350, 10 ** 4500, "", " ", "x", "nan", "1.5",
         "unknown", "known", "leg1", "*", "\x00", "\x1b[2J", "\ud800", "é" * 50, [], {}, [[]], [{}],
         {"": None}, [0, 0], [0, 0, 0], [1, 2, 3], [1e200] * 3, {"value": 1}, {"share": "a"},
         {"same_as": "x"}, {"x": 1, "y": 2, "rz": 3}, [None], ["a", "a"]]


def mutated(data, others, rng, form="text"):
    """Return ``data`` changed one to four times; ``others``: inputs to take parts from.

    ``form``: text, csv or tree, for changes that know of cells or of keys.
    """
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        data = rng.choice(WAYS[form])(data, others, rng)
    if rng.random() < LONG:
        data = _run(data, rng)
    return data[:200_000]


def _run(data, rng):
    """Repeat a short piece so often that what is not linear in it takes long."""
    at = rng.randrange(len(data) + 1)
    piece = rng.choice((data[at:at + rng.choice((1, 1, 2, 4, 12))], rng.choice(PIECES))) or b" "
    count = rng.choice((200, 2000, 20_000, 190_000)) // len(piece) + 1
    return data[:at] + piece * count + rng.choice((b"", b"!", data[at:]))


def _bytes(data, others, rng):
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at = rng.randrange(len(out) + 1)
        what = rng.randrange(4)
        if what == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif what == 1 and at < len(out):
            out[at] = rng.randrange(256)
        elif what == 2:
            del out[at:at + rng.choice((1, 2, 5, 30))]
        else:
            out[at:at] = bytes([rng.randrange(256)])
    return bytes(out)


def _word(data, others, rng):
    word = rng.choice(rng.choice((WORDS, NUMBERS))).encode("utf-8", "surrogatepass")
    at = rng.randrange(len(data) + 1)
    return data[:at] + word + data[at + rng.choice((0, 0, 1, len(word))):]


def _number(data, others, rng):
    found = list(NUMBER.finditer(data))
    if not found:
        return _word(data, others, rng)
    at = rng.choice(found)
    if rng.random() < 0.5:
        new = rng.choice(NUMBERS).encode()
    else:
        new = repr(float(at[0]) * rng.choice((-1.0, 1e3, 1e-3, 1.01, 1e9, 0.0))).encode()
    return data[:at.start()] + new + data[at.end():]


def _cut(data, others, rng):
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    return rng.choice((data[:a], data[b:], data[:a] + data[b:], data[a:b]))


def _lines(data, others, rng):
    lines = data.splitlines(keepends=True) or [b""]
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(5)
    if what == 0:
        del lines[i]
    elif what == 1:
        lines[i:i] = [lines[j]] * rng.choice((1, 2, 50))
    elif what == 2:
        lines[i], lines[j] = lines[j], lines[i]
    elif what == 3:
        theirs = rng.choice(others).splitlines(keepends=True) or [b""]
        lines[i:i] = [rng.choice(theirs)]
    else:
        words = lines[i].split()
        rng.shuffle(words)
        lines[i] = b" ".join(words[:rng.randrange(len(words) + 1)]) + b"\n"
    return b"".join(lines)


def _spliced(data, others, rng):
    other = rng.choice(others)
    return data[:rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1):]


def _recoded(data, others, rng):
    text = data.decode("utf-8", "replace")
    return rng.choice((
        lambda: text.encode("utf-16"), lambda: b"\xef\xbb\xbf" + data,
        lambda: text.encode("latin-1", "replace"), lambda: data.replace(b"\n", b"\r\n"),
        lambda: data.replace(b"\n", b"\r"), lambda: data.replace(b",", b";"),
        lambda: data.replace(b",", b"\t"), lambda: data.replace(b".", b","),
        lambda: data.upper(), lambda: data.replace(b"\n", b"\n\n"), lambda: data.strip(),
        lambda: data.replace(b" ", b"")))()


def _cells(data, others, rng):
    """Change cells, rows and columns of a CSV."""
    try:
        rows = list(csv.reader(io.StringIO(data.decode("utf-8"))))
    except (csv.Error, ValueError):
        return _bytes(data, others, rng)
    rows = [r for r in rows if r]
    if not rows:
        return _word(data, others, rng)
    what, i = rng.randrange(6), rng.randrange(len(rows))
    c = rng.randrange(len(rows[i]))
    rows[0] = rows[0] or [""]
    if what == 0:
        rows[i][c] = rng.choice(rng.choice((WORDS, NUMBERS)))
    elif what == 1:
        rows = [r[:c] + r[c + 1:] for r in rows]
    elif what == 2:
        rows = [r + (r[c:c + 1] or [""]) for r in rows]
        rows[0][-1] = rng.choice((*WORDS, *rows[0], f"sigma_{rows[0][c % len(rows[0])]}"))
    elif what == 3:
        new = rng.choice((*NUMBERS, ""))
        rows[1:] = [r[:c] + [new] + r[c + 1:] for r in rows[1:]]
    elif what == 4:
        rows[0][c % len(rows[0])] = rng.choice((*WORDS, *(f"{w}_{rows[0][0]}" for w in (
            "dir", "vel", "to", "cmd", "quat"))))
    else:
        rows = [rows[0], *rng.sample(rows[1:], rng.randrange(len(rows)))]
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue().encode("utf-8", "surrogatepass")


def _tree(data, others, rng):
    """Change a node of a YAML or JSON tree."""
    try:
        if data.lstrip()[:1] == b"{":
            tree = json.loads(data)
        else:
            tree = yaml.load(data, Loader=yaml.CSafeLoader)
        places = list(_places(tree))
    except Exception:    # PyYAML raises anything of some texts
        return _bytes(data, others, rng)
    if not places:
        return _word(data, others, rng)
    # small trees keep their shape; of large ones the many numbers would win always
    node, key = rng.choice(places)
    what = rng.randrange(7)
    if what <= 2:
        node[key] = rng.choice(TREES)
    elif what == 3:
        del node[key]
    elif what == 4 and isinstance(node, dict):
        node[rng.choice((*WORDS, *map(str, node)))] = node.pop(key)
    elif what == 5:
        other, name = rng.choice(places)
        node[key] = json.loads(json.dumps(other[name], default=str)) if name in _keys(other) else 1
    else:
        node[key] = rng.choice(([node[key]], {"value": node[key]}, [node[key]] * 3, str(node[key])))
    try:
        return json.dumps(tree, indent=rng.choice((None, 1)), default=str).encode()
    except (ValueError, RecursionError, TypeError):    # a tree in itself, an endless number
        return data


def _keys(node):
    return node if isinstance(node, dict) else range(len(node))


def _places(tree):
    stack = [tree]
    while stack:
        node = stack.pop()
        if not isinstance(node, dict | list):
            continue
        keys = list(_keys(node))
        if len(keys) > 12 and isinstance(node, list):
            keys = keys[:4] + keys[-4:]
        for key in keys:
            yield node, key
            stack.append(node[key])


_TEXT = (_bytes, _word, _number, _number, _cut, _lines, _spliced, _recoded)
WAYS = {"text": _TEXT, "csv": (*_TEXT, *[_cells] * 6), "tree": (*_TEXT, *[_tree] * 12)}


def smaller(data, still_fails, tries=300, seed=0):
    """Return a shorter input that fails alike: lines, then blocks of bytes, are taken out."""
    rng, left = random.Random(seed), tries
    for parts in (lambda d: d.splitlines(keepends=True),
                  lambda d: [d[i:i + max(1, len(d) // 24)]
                             for i in range(0, len(d), max(1, len(d) // 24))]):
        again = True
        while again and left > 0:
            again = False
            pieces = parts(data)
            for i in rng.sample(range(len(pieces)), len(pieces)):
                shorter = b"".join(pieces[:i] + pieces[i + 1:])
                left -= 1
                if left <= 0:
                    break
                if shorter != data and still_fails(shorter):
                    data, again = shorter, True
                    break
    return data


def fewer_rows(data, still_fails, tries=15):
    """Return a case with fewer rows and columns that fails alike."""
    while tries > 0:
        for table in _with_less(json.loads(data)["table"]):
            tries -= 1
            shorter = json.dumps(json.loads(data) | {"table": table}).encode()
            if still_fails(shorter):
                data = shorter
                break
            if tries <= 0:
                return data
        else:
            return data
    return data


def _with_less(table):
    """Yield the columns without a half of their rows, and without one of them."""
    n = max(map(len, table.values()), default=0)
    if n > 1:
        yield {name: values[:n // 2] for name, values in table.items()}
        yield {name: values[n // 2:] for name, values in table.items()}
    for left_out in table:
        yield {name: values for name, values in table.items() if name != left_out}
