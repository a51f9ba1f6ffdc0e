"""What a study's figures rest on: a digest of the code that decides, whatever its comments say."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path
from typing import TypeGuard

import ppmcal

PACKAGE = Path(ppmcal.__file__).parent
UNTOLD = ("type_params", "annotation", "returns", "type_comment")
"""Fields of a syntax tree that decide nothing."""


def engine_digest(packages: tuple[str, ...], but: tuple[str, ...] = ()) -> str:
    """Return 12 hex digits that change with the code of the packages, not with words about it.

    In which module a definition stands does not count, nor what annotations and sentences say.
    ``but``: paths of modules that do not count.
    """
    found = [piece for package in packages for path in (PACKAGE / package).rglob("*.py")
             if path.relative_to(PACKAGE).as_posix() not in but
             for piece in pieces_of(path.read_text(encoding="utf-8"))]
    return hashlib.sha256("\n".join(sorted(found)).encode()).hexdigest()[:12]


@cache
def pieces_of(source: str) -> frozenset[str]:
    """Return the syntax trees of a module's statements as texts.

    Without docstrings, comments, layout and annotations; of what it imports from the package only
    what it calls otherwise counts.
    """
    tree = ast.parse(source)
    aliases = {f"{a.name} as {a.asname}" for node in ast.walk(tree) if _of_package(node)
               for a in node.names if a.asname not in (None, a.name)}
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                s for s in body if not (_of_package(s) or _is_text(s))]
    return frozenset(aliases | {unparsed(statement) for statement in tree.body})


def _of_package(statement: ast.AST) -> TypeGuard[ast.ImportFrom]:
    return (isinstance(statement, ast.ImportFrom)
            and (statement.module or "").partition(".")[0] == "ppmcal")


def _is_text(statement: ast.AST) -> bool:
    """Whether it is a string that stands alone: a docstring, also below a constant."""
    return (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            and isinstance(statement.value.value, str))


def _is_sentence(tree: ast.AST) -> bool:
    parts = tree.values if isinstance(tree, ast.JoinedStr) else [tree]
    said = [p.value for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)]
    return len(" ".join(said).split()) > 2


def unparsed(tree: ast.AST) -> str:
    """Return what `ast.dump` says, the same from Python 3.11 on (3.13 leaves empty lists out).

    Sentences are left out: text of three words or more is for people, and nothing compares it. A
    note is its text: level and topic say how it is told.
    """
    if not isinstance(tree, ast.AST):
        if isinstance(tree, list):
            return "[" + ",".join(unparsed(t) for t in tree) + "]"
        return repr(tree)
    if _is_sentence(tree):
        return "Sentence"
    if isinstance(tree, ast.Call):
        called = tree.func
        if isinstance(called, ast.Name) and called.id == "Note":
            return unparsed(tree.args[0])
        if isinstance(called, ast.Subscript):    # list[str](): what it will hold is an annotation
            return unparsed(ast.Call(called.value, tree.args, tree.keywords))
    fields = (f"{name}={unparsed(value)}" for name, value in ast.iter_fields(tree)
              if value not in (None, []) and name not in UNTOLD)
    return f"{type(tree).__name__}({','.join(fields)})"
