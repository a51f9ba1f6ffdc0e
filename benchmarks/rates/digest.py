"""What a study's figures rest on: a digest of the code that decides, whatever its comments say."""

from __future__ import annotations

import ast
import hashlib
from pathlib import Path
from typing import TypeGuard

import ppmcal


def engine_digest(packages: tuple[str, ...], but: tuple[str, ...] = ()) -> str:
    """Return 12 hex digits that change with the code of the packages, not with words about it.

    ``but``: paths of modules that do not count.
    """
    root = Path(ppmcal.__file__).parent
    total = hashlib.sha256()
    for package in packages:
        for path in sorted((root / package).rglob("*.py")):
            if path.relative_to(root).as_posix() in but:
                continue
            total.update(path.relative_to(root).as_posix().encode())
            total.update(code_of(path.read_text(encoding="utf-8")).encode())
    return total.hexdigest()[:12]


def code_of(source: str) -> str:
    """Return a module's syntax tree as text, without docstrings, comments and layout.

    Of what it imports from the package the names count, and not in which module each stands.
    """
    tree = ast.parse(source)
    names: list[str] = []
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            names += [f"{a.name} as {a.asname or a.name}" for s in body if _of_package(s)
                      for a in s.names]
            node.body = [  # type: ignore[attr-defined]
                s for s in body if not (_of_package(s) or _is_text(s))]
    return f"{sorted(names)}{unparsed(tree)}"


def _of_package(statement: ast.AST) -> TypeGuard[ast.ImportFrom]:
    return (isinstance(statement, ast.ImportFrom)
            and (statement.module or "").partition(".")[0] == "ppmcal")


def _is_text(statement: ast.AST) -> bool:
    """Whether it is a string that stands alone: a docstring, also below a constant."""
    return (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            and isinstance(statement.value.value, str))


def unparsed(tree: ast.AST) -> str:
    """Return what `ast.dump` says, the same from Python 3.11 on (3.13 leaves empty lists out)."""
    if not isinstance(tree, ast.AST):
        if isinstance(tree, list):
            return "[" + ",".join(unparsed(t) for t in tree) + "]"
        return repr(tree)
    fields = (f"{name}={unparsed(value)}" for name, value in ast.iter_fields(tree)
              if value not in (None, []) and name != "type_params")
    return f"{type(tree).__name__}({','.join(fields)})"
