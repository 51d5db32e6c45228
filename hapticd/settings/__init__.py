"""From TOML files to frozen parameters, or to a message with file, line, value, unit and limit.

    config/hapticd.toml --.                               .--> ServoParams   servo.json
                          |-- load --> Settings -- build -|--> BoardParams   board.json, simulated
    devices/NAME.toml ----'                               '--> GatewayParams gateway.json
    scenes/NAME.toml --------- load_scene -------------------> Scene         for simulations

A unit lives in the name of its field and nowhere else. A default is written once, in
`hapticd.core.params`; what the board is, and what one count means on it, in its device file alone.

For scripts:

    load     load(file, overrides) -> Settings: the validated configuration with its device
    scene    load_scene(name or file) -> Scene; scene_names(); schema(kind)
    build    servo_params, board_params, gateway_params, device_params: what processes read
    inputs   regular(path): what somebody named, if it can be read without waiting
    toml     shipped(folder): files that travel with the package; read(file); did_you_mean

`config` and `device` are the tables themselves, `tables` reads them and says what is wrong; `guard`
writes guard.json.

A fact that the device file holds must have no second place (limits and scales are checked against
it, not repeated). No value may change after validation (overrides are merged before it, so that
they are checked as well).
"""
