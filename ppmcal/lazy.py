"""Package names that are loaded on first use, so that a command loads only what it needs."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any


def on_first_use(package: str) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package: it loads the names imported for type checkers.

    The package lists its names once, below ``if TYPE_CHECKING:``, as ``from m import A as A``.
    """
    def load(name: str) -> Any:
        home = _homes(str(sys.modules[package].__file__)).get(name)
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(home), name)
        setattr(sys.modules[package], name, value)
        return value

    return load


@cache
def _homes(path: str) -> dict[str, str]:
    """Return the module of each name that a file imports for type checkers only."""
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    return {alias.name: str(node.module) for block in tree.body if isinstance(block, ast.If)
            and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"
            for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
