"""The end of a trial is typed: reason, fault and, for people, a sentence."""

import pytest

from hapticd.zwidth.store import EndReason, TrialEnd, end_of_plain, to_json


@pytest.mark.parametrize("end", [None, *(TrialEnd(one, "x", "energy") for one in EndReason)])
def test_an_end_survives_json(end):
    assert end_of_plain(to_json(end)) == end


@pytest.mark.parametrize("fault", ["overspeed", "energy", "force_at_limit"])
def test_a_runaway_is_known_by_its_fault_and_not_by_its_words(fault):
    assert TrialEnd(EndReason.FAULT, "", fault).ran_away
    assert not TrialEnd(EndReason.FAULT, fault, "encoder_jump").ran_away
    assert not TrialEnd(EndReason.HEAT, "escape").ran_away


def test_an_end_of_another_kind_is_refused():
    with pytest.raises(ValueError, match="tired"):
        end_of_plain({"reason": "tired", "text": "", "fault": ""})
