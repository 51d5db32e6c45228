"""`python -m firmware_iface.hardware FOLDER`: figures, schematic, device file from the netlist."""

import sys
from pathlib import Path

from firmware_iface.hardware import device_file, figures, schematic

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/circuit")
folder.mkdir(parents=True, exist_ok=True)
schematic.drawn(folder / "circuit-schematic.svg")
figures.drawn(folder / "circuit-studies.svg")
text = device_file.written(device_file.measured(), device_file.intervals(), device_file.CIRCUITS)
(folder / f"{device_file.NAME}.toml").write_text(text)
sys.stdout.write(f"{folder}: schematic, studies, {device_file.NAME}.toml\n")
