"""From TOML files to frozen parameters, or to a message that names file, line, field, value, unit and limit.

    config/hapticd.toml --.                              .--> ServoParams    (servo.json)
                          |-- load --> Settings -- build -|--> BoardParams    (board.json, simulated boards only)
    devices/NAME.toml ----'                              '--> GatewayParams  (gateway.json)

Rules. The models are strict (no "100" for 100), closed (no unknown key), frozen, and refuse NaN and infinity. A unit
lives in the name of its field and nowhere else: `quantities.unit_of` reads it for messages and for the JSON schema. A
default is written once, in `hapticd.params`; what the board is, and what one count means on it, in its device file alone.

What would break it: a second place for a fact that the device file holds (limits and scales are checked against it, not
repeated), or a value changed after validation (overrides are merged before it, so that they are checked as well).
"""
