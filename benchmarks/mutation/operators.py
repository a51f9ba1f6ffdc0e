"""Which small faults can be put into a module, one at a time, on its syntax tree."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

BINARY: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd}
COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.GtE, ast.LtE), ast.LtE: (ast.Gt, ast.Lt), ast.Gt: (ast.LtE, ast.GtE),
    ast.GtE: (ast.Lt, ast.Gt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,)}
CALLS = {"min": "max", "minimum": "maximum", "any": "all", "sin": "cos", "zeros": "ones",
         "argmin": "argmax", "zeros_like": "ones_like", "sum": "mean", "floor": "ceil",
         "logical_or": "logical_and"}
CALLS |= {value: key for key, value in CALLS.items()}
SYMBOLS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%",
    ast.Pow: "**", ast.BitAnd: "&", ast.BitOr: "|", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">",
    ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.Is: "is", ast.IsNot: "is not",
    ast.In: "in", ast.NotIn: "not in", ast.And: "and", ast.Or: "or"}
NUMBERS = ("Array", "Ints", "float", "int", "tuple[Array, Array]")
"""A function that returns one of these is made to return the negative."""

Place = tuple[str | int, ...]
"""The way from a module's tree to a node: attributes and indices."""


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes:
        file: relative to the project's folder.
        line: where, as the file is now.
        text: the first line of what is changed, stripped.
        change: what it becomes.
        nth: which of the same in the file.
        place: of the node in the tree.
        at_import: whether the line runs when the module is imported, in no function.
    """

    file: str
    line: int
    text: str
    change: str
    nth: int
    place: Place
    at_import: bool

    @property
    def name(self) -> str:
        """What stays the same when the file is edited elsewhere."""
        return f"{self.file}: {self.text} [{self.change}]" + (
            f" ({self.nth + 1})" if self.nth else "")

    def drawn(self, seed: int) -> str:
        """Return the mutant's place in the drawing: those with the first are taken."""
        return hashlib.sha256(f"{seed} {self.name}".encode()).hexdigest()


def mutants_of(file: str, source: str) -> list[Mutant]:
    """Return all mutants of a module in the order of its lines."""
    lines, count = source.splitlines(), dict[tuple[str, str], int]()
    out = []
    for node, place, inside in _nodes(ast.parse(source), (), False):
        line = getattr(node.iter if isinstance(node, ast.comprehension) else node, "lineno", 1)
        text = lines[line - 1].strip()
        for change, _ in _changes(node):
            nth = count[text, change] = count.get((text, change), -1) + 1
            out.append(Mutant(file, line, text, change, nth, place, not inside))
    return sorted(out, key=lambda m: (m.line, m.name))


def mutated(source: str, mutant: Mutant) -> ast.Module:
    """Return the tree of a module with the fault in it."""
    tree = ast.parse(source)
    parent: object = tree
    for step in mutant.place[:-1]:
        parent = parent[step] if isinstance(step, int) else getattr(parent, step)  # type: ignore[index]
    last = mutant.place[-1]
    node = parent[last] if isinstance(last, int) else getattr(parent, last)  # type: ignore[index]
    new = dict(_changes(node))[mutant.change]()
    if isinstance(last, int):
        parent[last] = new  # type: ignore[index]
    else:
        setattr(parent, last, new)
    return ast.fix_missing_locations(tree)


def _nodes(node: ast.AST, place: Place, inside: bool) -> Iterator[tuple[ast.AST, Place, bool]]:
    """Yield what may be changed; no annotation, docstring, decorator, message or import."""
    if isinstance(node, ast.Raise | ast.Import | ast.ImportFrom | ast.JoinedStr | ast.Assert):
        if isinstance(node, ast.Raise):
            yield node, place, inside
        return
    yield node, place, inside
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "type_comment") or (
                isinstance(value, ast.Name)):
            continue
        within = inside or (isinstance(node, ast.FunctionDef | ast.Lambda) and name == "body")
        if isinstance(value, list):
            for n, child in enumerate(value):
                if isinstance(child, ast.AST):
                    yield from _nodes(child, (*place, name, n), within)
        elif isinstance(value, ast.AST):
            yield from _nodes(value, (*place, name), within)


def _changes(node: ast.AST) -> Iterator[tuple[str, Callable[[], ast.AST]]]:
    """Yield how a node can be wrong: in words, and what makes it so, in place where it can."""
    match node:
        case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in BINARY:
            yield _swap(node, "op", op, BINARY[type(op)])
        case ast.BoolOp(op=op):
            yield _swap(node, "op", op, ast.Or if isinstance(op, ast.And) else ast.And)
        case ast.Compare(ops=ops):
            for n, op in enumerate(ops):
                for other in COMPARISONS[type(op)]:
                    yield _swap(ops, n, op, other, node)
        case ast.UnaryOp(op=op, operand=operand) if not isinstance(op, ast.UAdd):
            sign = {ast.USub: "-", ast.Not: "not", ast.Invert: "~"}[type(op)]
            yield f"no {sign}", lambda: operand
        case ast.Constant(value=bool(value)):
            yield f"{value} -> {not value}", lambda: ast.Constant(not value)
        case ast.Constant(value=int(value) | float(value)):
            yield f"{value} -> {value + 1}", lambda: ast.Constant(value + 1)
        case ast.IfExp(body=body, orelse=orelse):
            yield "branches swapped", lambda: ast.IfExp(node.test, orelse, body)
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name) as func) if name in CALLS:
            yield _renamed(node, func, name)
        case ast.comprehension(ifs=[_, *_]):
            yield "no filter", lambda: ast.comprehension(
                node.target, node.iter, [], node.is_async)
    yield from _statement_changes(node)


def _statement_changes(node: ast.AST) -> Iterator[tuple[str, Callable[[], ast.AST]]]:
    match node:
        case ast.If() | ast.While():
            yield from _set(node, "test", {"never": ast.Constant(False)}
                            if isinstance(node, ast.While) else
                            {"never": ast.Constant(False), "always": ast.Constant(True)})
        case ast.FunctionDef(returns=returns) if returns and ast.unparse(returns) in NUMBERS:
            for n, statement in enumerate(_returned(node)):
                yield f"return {n + 1} negated", lambda s=statement: _negated(node, s)
        case ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Raise():
            yield "deleted", ast.Pass
        case ast.Assign(targets=[ast.Subscript(), *_]):
            yield "deleted", ast.Pass
        case ast.Break():
            yield "continue", ast.Continue
        case ast.Continue():
            yield "break", ast.Break


def _returned(function: ast.FunctionDef) -> list[ast.Return]:
    return [n for n in ast.walk(function)
            if isinstance(n, ast.Return) and n.value is not None
            and not isinstance(n.value, ast.Tuple | ast.Constant)]


def _negated(function: ast.FunctionDef, statement: ast.Return) -> ast.AST:
    if function.returns is not None and ast.unparse(function.returns).startswith("tuple"):
        return _first_negated(function, statement)
    assert statement.value is not None
    statement.value = ast.UnaryOp(ast.USub(), statement.value)
    return function


def _first_negated(function: ast.FunctionDef, statement: ast.Return) -> ast.AST:
    assert statement.value is not None
    statement.value = ast.Call(ast.parse("lambda t: (-t[0], *t[1:])", mode="eval").body,
                               [statement.value], [])
    return function


def _set(node: ast.AST, field: str, values: dict[str, ast.expr]
         ) -> Iterator[tuple[str, Callable[[], ast.AST]]]:
    for words, value in values.items():
        def make(value: ast.expr = value) -> ast.AST:
            setattr(node, field, value)
            return node
        yield words, make


def _swap(holder: object, where: str | int, old: ast.AST, new: type[ast.AST],
          node: ast.AST | None = None) -> tuple[str, Callable[[], ast.AST]]:
    def make() -> ast.AST:
        if isinstance(where, int):
            holder[where] = new()  # type: ignore[index]
        else:
            setattr(holder, where, new())
        found = node or holder
        assert isinstance(found, ast.AST)
        return found
    return f"{SYMBOLS[type(old)]} -> {SYMBOLS[new]}", make


def _renamed(node: ast.AST, func: ast.Name | ast.Attribute, name: str
             ) -> tuple[str, Callable[[], ast.AST]]:
    def make() -> ast.AST:
        setattr(func, "id" if isinstance(func, ast.Name) else "attr", CALLS[name])
        return node
    return f"{name} -> {CALLS[name]}", make
