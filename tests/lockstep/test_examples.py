"""Examples run as they stand; those that need a daemon are in the process tests."""

import importlib.util

import pytest
from support.tree import ROOT

EXAMPLES = ROOT / "examples"


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_envelope_example_draws_what_passed(tmp_path):
    pytest.importorskip("matplotlib")
    passed = loaded("envelope").main(tmp_path, trials=40, seconds=15.0)
    assert 0 < passed < 40
    assert (tmp_path / "envelope.png").stat().st_size > 10_000
