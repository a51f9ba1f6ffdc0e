"""Formulas in pages as MathML, which browsers draw by themselves: no script, no network.

``$...$`` stands in a line, ``$$...$$`` in paragraphs of its own, as TeX. Code is left alone.
"""

from __future__ import annotations

import re

from latex2mathml.converter import convert

CODE = re.compile(r"(^```.*?^```[^\n]*$|`[^`\n]+`)", re.M | re.S)
BLOCK = re.compile(r"^\$\$\n?(.+?)\n?\$\$$", re.M | re.S)
INLINE = re.compile(r"(?<![\\$\w])\$(?=\S)([^$\n]+?)(?<=\S)\$(?![\w$])")


def with_formulas(text: str) -> str:
    """Return Markdown with its formulas as MathML."""
    parts = CODE.split(text)
    return "".join(part if i % 2 else _converted(part) for i, part in enumerate(parts))


def _converted(text: str) -> str:
    text = BLOCK.sub(lambda m: f'<div class="formula">{_math(m[1], "block")}</div>', text)
    # a line that began with <math> would be a block of its own
    return INLINE.sub(lambda m: f"<span>{_math(m[1], 'inline')}</span>", text)


def _math(tex: str, display: str) -> str:
    out = convert(" ".join(tex.split()), display=display)
    # what Markdown would take for its own
    return out.replace("*", "&#42;").replace("_", "&#95;").replace("\n", "")
