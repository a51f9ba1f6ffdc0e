"""Numbers in files that are shipped or written are numbers to readers of YAML 1.1 too."""

from __future__ import annotations

import math

import pytest
import yaml
from helpers.paths import ROOT

from ppmcal.io.yaml import number_text

FILES = sorted([*(ROOT / "configs").rglob("*.yaml"), *(ROOT / "sample_data").rglob("*.yaml")])


def texts(tree):
    if isinstance(tree, dict):
        for value in tree.values():
            yield from texts(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from texts(value)
    elif isinstance(tree, str):
        yield tree


def is_number(text):
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_number_is_text_to_yaml_1_1(path):
    assert not [t for t in texts(yaml.safe_load(path.read_text(encoding="utf-8"))) if is_number(t)]


@pytest.mark.parametrize("value", [8.13e8, 1e-5, 1e20, 1.5e-300, 123456789.0, 0.1, 5e300])
def test_what_is_written_is_a_number_to_both(value):
    assert yaml.safe_load(number_text(value)) == value
