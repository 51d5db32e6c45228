"""Every check of the doctor in every branch, on machines made of a few files."""

import pytest

from hapticd.run.doctor import late


@pytest.mark.process
def test_worker_reports_rights_and_histogram() -> None:
    found = late.measure(0.05, None)
    assert sum(found["histogram_us"].values()) == 50
    assert found["rights"]["garbage_collector"]["granted"]
    assert found["p50_us"] <= found["max_us"]
