"""The signs of a device file are verified as long as they are those that somebody has seen."""

import pytest
from test_settings_signs import EDITED, device_with, greatest_force_n


@pytest.mark.parametrize("edit", EDITED)
def test_a_sign_that_was_edited_since_is_not_verified(tmp_path, edit):
    device = device_with(tmp_path, *EDITED[edit])
    assert device.commissioning
    assert greatest_force_n(device) <= 0.1 * device.force_limit_n + device.force.per_count
