"""The paper's equations by hand, and the interval of a mean over seeds."""

import re

import numpy as np
import pytest

from examples.weir2008.future_figures import mean_interval
from examples.weir2008.paper import paper_equation_2
from examples.weir2008.rows import crowbar_nms_per_rad, lever_of_crowbar_m
from hapticd.core.errors import AnalysisError
from hapticd.model.theorem import required_damping


@pytest.mark.parametrize(("physical", "holds"), [(1.051, True), (1.05, False), (0.9, False)])
def test_equation_2_as_printed(physical, holds):
    assert paper_equation_2(100.0, 1.0, physical) is holds


def test_equation_2_refuses_negative_damping_and_says_why():
    message = (
        "Eq. 2 does not hold for B = -0.5 N s/m: printed as b > KT/2 + B it would relax for"
        " negative virtual damping, the theorem asks for b > KT/2 - B cos wT, here 0.55 N s/m at 0"
        " Hz; use required_damping"
    )
    with pytest.raises(AnalysisError, match=re.escape(message)):
        paper_equation_2(100.0, -0.5, 10.0)
    assert required_damping([[100.0, -0.5, 0.0]], filters=(None, None))[0][0] == pytest.approx(
        0.55, rel=1e-5
    )


def test_equation_2_refuses_negative_stiffness():
    """It is active at low frequencies, and b > KT/2 + B would relax for it."""
    with pytest.raises(AnalysisError, match=r"Eq\. 2 does not hold for K = -34 N/m"):
        paper_equation_2(-34.0, 0.0, 1.0)


def test_crowbar_figures_of_the_paper():
    """Eq. 3: 1.7e-4 Nms/rad; its 3.7e-5 Ns/m would need a lever of 2.14 m, and 10 mm gives 1.70
    Ns/m.
    """
    crowbar = crowbar_nms_per_rad(0.016492422502470644, 1.6)
    assert crowbar == pytest.approx(1.7e-4, rel=1e-12)
    assert lever_of_crowbar_m(1.7e-4, 3.7e-5) == pytest.approx(2.1435, abs=1e-4)
    assert crowbar / 0.01**2 == pytest.approx(1.70, rel=1e-12)


def test_interval_of_few_seeds_is_by_students_t():
    """t of 97.5 %: 12.7062 with one degree of freedom, 4.30265 with two, 2.36462 with seven."""
    assert mean_interval(1) == 0.0
    assert mean_interval(2) * np.sqrt(2.0) == pytest.approx(12.7062, rel=1e-4)
    assert mean_interval(3) * np.sqrt(3.0) == pytest.approx(4.30265, rel=1e-4)
    assert mean_interval(8) * np.sqrt(8.0) == pytest.approx(2.36462, rel=1e-4)
