"""What the processes really load. import-linter (in `make test`) holds the declared layers;
this looks at what runs.
"""

from support.layers import NEVER_IN_SERVO, modules_after, packages


def test_servo_of_a_real_board_loads_no_simulator() -> None:
    """Importing the process is what a servo of a real board does; a simulated one imports more."""
    modules = modules_after(
        "import json, sys, hapticd.run.servo_main; print(json.dumps(sorted(sys.modules)))"
    )
    assert packages(modules) & NEVER_IN_SERVO == set()
    assert not [name for name in modules if name.startswith(("hapticd.sim", "hapticd.model"))]


def test_quick_stop_loads_no_models() -> None:
    modules = modules_after(
        "import json, sys, hapticd.__main__, hapticd.client.fast_stop;"
        " print(json.dumps(sorted(sys.modules)))"
    )
    assert (
        packages(modules) & {"numpy", "pydantic", "typer", "rich", "zmq", "msgpack", "asyncio"}
        == set()
    )


def test_command_line_starts_without_models() -> None:
    modules = modules_after(
        "import json, sys, hapticd.cli.app; print(json.dumps(sorted(sys.modules)))"
    )
    assert packages(modules) & {"numpy", "pydantic", "zmq", "rich", "tomllib"} == set()
