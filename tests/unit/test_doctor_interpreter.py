"""The doctor names an interpreter that was built without optimisation."""

import pytest

from hapticd.run.doctor.interpreter import Build, judge, this_build

PYENV = Build("3.11.7", "/home/ada/.pyenv", "'--enable-shared'", "-DNDEBUG -g -O3 -Wall", False)
QUICK = "'--enable-optimizations' '--with-lto'"


@pytest.mark.parametrize(
    ("build", "level", "found"),
    [
        (PYENV, "warn", "Python 3.11.7 without profile-guided optimisation, -O3"),
        (
            PYENV._replace(options=QUICK),
            "ok",
            "Python 3.11.7, profile-guided and link-time optimisation, -O3",
        ),
        (PYENV._replace(prefix="/usr", flags="-O3 -g -O2"), "ok", "of the distribution, -O2"),
        (PYENV._replace(options=QUICK, flags="-O3 -O0"), "warn", "for debugging (-O0)"),
        (PYENV._replace(options=QUICK, debug=True), "warn", "for debugging"),
        (PYENV._replace(flags=""), "warn", "an unknown -O level"),
    ],
)
def test_build_is_named(build: Build, level: str, found: str) -> None:
    check = judge(build)
    assert check.level == level
    assert found in check.found
    assert bool(check.fix) == (level == "warn")


def test_interpreter_that_runs_is_known() -> None:
    assert this_build().version in judge(this_build()).found
