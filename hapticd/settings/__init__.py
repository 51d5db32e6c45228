"""From TOML files to frozen parameters, or to a message with file, line, value, unit and limit.

    config/hapticd.toml --.                               .--> ServoParams   servo.json
                          |-- load --> Settings -- build -|--> BoardParams   board.json, simulated
    devices/NAME.toml ----'                               '--> GatewayParams gateway.json
    scenes/NAME.toml --------- load_scene -------------------> Scene         for simulations

The unit of a field is part of its name and is defined nowhere else. A default is written once, in
`hapticd.core.params` or `hapticd.model.params`. The board and its values per count are only in its
device file.

For scripts:

    load     load(file, overrides) -> Settings: the validated configuration with its device
    scene    load_scene(name or file) -> Scene; scene_names(); schema(kind)
    build    servo_params, board_params, gateway_params, device_params: parameters of the processes
    toml     shipped(folder): files shipped with the package; read(file); did_you_mean;
             regular(path): a user's file, if it can be read without waiting

`config` and `device` define the tables; `config` also parses them and reports mistakes. `scene`
also writes guard.json.

A fact in the device file must not be repeated elsewhere (limits and scales are checked against it).
No value may change after validation (overrides are merged before it, so that they are checked as
well).
"""
