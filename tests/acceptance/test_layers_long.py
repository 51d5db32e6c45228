"""What the processes really load. import-linter (in `make test`) holds the declared layers;
this looks at what runs.
"""

from support.layers import modules_after, packages

NEVER_IN_GATEWAY = {"numba", "scipy", "usb", "typer", "rich", "tomllib"}


def test_gateway_brings_no_compiler_and_no_board() -> None:
    modules = modules_after(
        "import json, sys, hapticd.run.gateway_main; print(json.dumps(sorted(sys.modules)))"
    )
    assert packages(modules) & NEVER_IN_GATEWAY == set()
    assert not [
        name
        for name in modules
        if name.startswith(
            (
                "hapticd.servo",
                "hapticd.sim",
                "hapticd.zwidth.engine",
                "hapticd.settings",
                "hapticd.usb.device",
                "hapticd.usb.link",
                "hapticd.usb.flight",
            )
        )
    ]
