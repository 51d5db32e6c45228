"""The paper's figures: who owns an envelope there."""

from dataclasses import replace

import numpy as np
import pytest
from support import reproduced

from examples.weir2008.figures import drawn
from examples.weir2008.run import ReproduceResult
from hapticd.zwidth.passive_set import Edge
from hapticd.zwidth.report.envelope import NOBODY, Drawn, weighty


@pytest.fixture(scope="module")
def quick() -> ReproduceResult:
    return reproduced.by_prediction()


def test_nobody_owns_what_noise_alone_would_do(quick: ReproduceResult) -> None:
    """Largest and smallest of N equal trials lie about 2 sqrt(2 ln N) standard deviations apart."""
    seen = quick.found[1]
    count = len(seen.environments)
    factor = np.exp(np.sqrt(2.0 * np.log(count)) * 0.01)

    def spread(by: float) -> Drawn:
        upper = seen.envelope.upper
        lower = seen.envelope.lower
        middle = np.sqrt(upper.value * lower.value)
        sd = np.full(upper.value.size, 0.01)
        envelope = replace(
            seen.envelope,
            upper=Edge(middle * by, sd, upper.owner),
            lower=Edge(middle / by, sd, lower.owner),
        )
        return replace(drawn(quick, 1), envelope=envelope)

    noisy = spread(0.99 * factor)
    real = spread(1.01 * factor)
    assert (weighty(noisy, noisy.envelope.upper) == NOBODY).all()
    assert (weighty(real, real.envelope.upper) != NOBODY).mean() > 0.9
