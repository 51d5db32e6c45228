"""The fixtures for people's own scripts."""

import pytest

from hapticd.errors import ConfigError


def test_board_fixture_is_a_client_on_virtual_time(hapticd_board):
    hapticd_board.set(K=100, B=1)
    hapticd_board.enable()
    hapticd_board.run(1000)
    assert hapticd_board.newest["stiffness_n_per_m"] == 100
    assert hapticd_board.status()["state"] == "enabled"


class TestConfigOfYourOwn:
    @pytest.fixture
    def hapticd_config(self, tmp_path):
        path = tmp_path / "hapticd.toml"
        path.write_text("[realtime]\nrate_hz = 2000.0\n")
        return path

    def test_rate_is_that_of_the_file(self, hapticd_board):
        assert hapticd_board.hello()["servo"]["realtime"]["rate_hz"] == 2000.0


class TestRealBoard:
    @pytest.fixture
    def hapticd_config(self, tmp_path):
        path = tmp_path / "hapticd.toml"
        path.write_text('device = "example-board"\n')
        return path

    def test_real_board_has_no_virtual_time(self, request):
        with pytest.raises(ConfigError, match="a real board's"):
            request.getfixturevalue("hapticd_board")
