"""`hapticd zwidth`: what a person types, gets printed, and finds in the run folder; slips are
named and nothing is started.
"""

import pytest
from support.cli_zwidth import run, small_map, trials


@pytest.mark.process
def test_map_runs_in_processes(tmp_path, capsys):
    assert run(small_map(tmp_path / "here"), capsys)[0] == 0
    assert run(small_map(tmp_path / "there", "--executor", "process"), capsys)[0] == 0
    assert trials(tmp_path / "there") == trials(tmp_path / "here")
