"""The schematic of the circuit, drawn from the values of values.inc with schemdraw."""

from pathlib import Path

from firmware_iface.hardware.netlist import VALUES

__all__ = ["drawn"]

PREFIXES = ((1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "u"), (1e-9, "n"))


def shown(name: str) -> str:
    """Return the value of a part in schematic notation: 6.65k, 3.3n."""
    value = VALUES[name].value
    size, prefix = next(pair for pair in PREFIXES if value >= pair[0])
    return f"{value / size:g}{prefix}"


def drawn(path: Path) -> None:
    """Draw the schematic into `path` (SVG)."""
    import schemdraw
    from schemdraw import elements as elm

    schemdraw.use("svg")
    with schemdraw.Drawing(file=str(path), show=False) as d:
        d.config(fontsize=11, unit=2.2)
        controller = elm.Opamp(leads=True).label("OPA192\nsum, PI", "center", fontsize=8)
        d += controller
        d += elm.Line().at(controller.in2).left(0.4)
        d += elm.Ground()
        node = d.add(elm.Dot().at(controller.in1))
        d += elm.Line().at(node.center).left(0.6)
        summing = d.add(elm.Dot())
        rows = ((1.6, "command", "r_c"), (0.0, "-i/2", "r_i"), (-1.6, "damping", "r_b"))
        for height, source, part in rows:
            d += elm.Line().at(summing.center).toy(summing.center[1] + height)
            d += elm.Resistor().left().label(shown(part))
            d += elm.Dot(open=True).label(source, "left")
        d += elm.Line().at(node.center).up(1.8)
        d += elm.Resistor().right(1.8).label(shown("r_z"))
        d += elm.Capacitor().right(1.8).label(shown("c_z"), "top")
        d += elm.Line().toy(controller.out[1])
        d += elm.Dot()
        d += elm.Line().at(controller.out).right(1.4)
        d += elm.Resistor().right().label(f"R1 {shown('r_1')}")
        power = d.add(elm.Opamp(leads=True).anchor("in1").label("OPA549", "center", fontsize=8))
        d += elm.Line().at(power.in2).left(0.3)
        d += elm.Ground()
        d += elm.Line().at(power.in1).up(1.6)
        d += elm.Resistor().right().tox(power.out[0]).label(f"R2 {shown('r_2')}")
        d += elm.Line().toy(power.out[1])
        d += elm.Dot()
        d += elm.Switch().at(power.out).right().label("stop relay:\nopens first")
        top = d.add(elm.Dot())
        d += elm.Line().down(0.6)
        d += elm.Inductor2().down(1.6).label(f"L {shown('l_motor')} + {shown('l_eddy')}")
        d += elm.Resistor().down(1.6).label(f"R {shown('r_motor')}")
        d += elm.SourceV().down(1.6).label("K v")
        low = d.add(elm.Dot())
        d += elm.Line().at(top.center).right(2.4)
        d += elm.Line().down(2.0)
        d += elm.Switch().down(1.6).label("shorts\nafter", "bottom")
        d += elm.Line().toy(low.center[1])
        d += elm.Line().tox(low.center[0])
        d += elm.Resistor().at(low.center).down(1.6).label(f"Rs {shown('r_sense')}")
        d += elm.Ground()
        d += elm.Line().at(low.center).left(1.2)
        d += elm.Dot(open=True).label("AD8421, gain 10:\n+i/2 (V/A)", "left")
        d += elm.Line().at(top.center).up(0.8)
        d += elm.Dot(open=True).label("AD8278, gain -1/2: -V/2", "right")
        emf = elm.Opamp(leads=True).right().at((0.5, -8.5))
        d += emf.label("OPA192\nback-EMF", "center", fontsize=8)
        d += elm.Line().at(emf.in2).left(0.4)
        d += elm.Ground()
        d += elm.Line().at(emf.in1).left(0.6)
        meeting = d.add(elm.Dot())
        parts = ((2.4, "-V/2", "r_v"), (0.8, "+i/2", "r_r"), (-0.8, "trim x i/2", "r_t"))
        for height, source, part in parts:
            d += elm.Line().at(meeting.center).toy(meeting.center[1] + height)
            d += elm.Resistor().left().label(shown(part))
            d += elm.Dot(open=True).label(source, "left")
        d += elm.Line().at(meeting.center).toy(meeting.center[1] - 2.4)
        d += elm.Capacitor().left().label(shown("c_d"))
        d += elm.Resistor().left().label(shown("r_d"))
        d += elm.Dot(open=True).label("+i/2", "left")
        d += elm.Line().at(emf.in1).up(1.8)
        d += elm.Resistor().right().tox(emf.out[0]).label(f"{shown('r_f')} || {shown('c_f')}")
        d += elm.Line().toy(emf.out[1])
        d += elm.Dot()
        d += elm.Line().at(emf.out).right(1.0)
        d += elm.RBox(w=1.6, h=1.0).right().label("DAC8812\nx -d", "center", fontsize=8)
        d += elm.Line().right(1.0)
        d += elm.Dot(open=True).label("damping", "right")
