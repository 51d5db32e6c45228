"""The fixtures for people's own scripts."""

import numpy as np
import pytest

from hapticd.core.errors import ConfigError


def test_board_fixture_is_a_client_on_virtual_time(hapticd_board):
    hapticd_board.set(K=100)
    hapticd_board.enable()
    hapticd_board.run(1000)
    assert hapticd_board.newest["stiffness_n_per_m"] == 100
    assert hapticd_board.status().state == "enabled"


def test_board_on_virtual_time_is_recorded_as_a_daemon_is(hapticd_board):
    hapticd_board.set(K=100, ramp_s=0.0)
    before = int(hapticd_board.newest["tick"])
    records, lost = hapticd_board.record(seconds=1.25)
    assert (len(records), lost) == (1250, 0)
    assert int(records["tick"][0]) == before + 1
    assert int(hapticd_board.newest["tick"]) - int(records["tick"][-1]) < 40
    assert (np.diff(records["tick"].astype(np.int64)) == 1).all()
    probe, lost = hapticd_board.record(seconds=0.5, topic="probe")
    assert (len(probe), lost) == (2000, 0)


def test_what_only_a_gateway_publishes_is_refused_on_virtual_time(hapticd_board):
    with pytest.raises(ConfigError, match=r"event: on virtual time there are servo\.raw and probe"):
        next(hapticd_board.listen("event"))


class TestConfigOfYourOwn:
    @pytest.fixture
    def hapticd_config(self, tmp_path):
        path = tmp_path / "hapticd.toml"
        path.write_text("[realtime]\nrate_hz = 2000.0\n")
        return path

    def test_rate_is_that_of_the_file(self, hapticd_board):
        assert hapticd_board.hello().servo.realtime.rate_hz == 2000.0


class TestRealBoard:
    @pytest.fixture
    def hapticd_config(self, tmp_path):
        path = tmp_path / "hapticd.toml"
        path.write_text('device = "example-board"\n')
        return path

    def test_real_board_has_no_virtual_time(self, request):
        with pytest.raises(ConfigError, match="a real board's"):
            request.getfixturevalue("hapticd_board")
