"""Figures and schematic of the circuit are drawn from its values by one command."""

import re

import pytest
from support.programs import program

from firmware_iface.hardware import figures, schematic
from firmware_iface.hardware.netlist import FOLDER, VALUES

DOCS = FOLDER.parents[1] / "docs"


def test_schematic_shows_the_values_of_the_parts(tmp_path):
    pytest.importorskip("schemdraw", reason="install it with the group `docs`")
    schematic.drawn(tmp_path / "schematic.svg")
    text = (tmp_path / "schematic.svg").read_text()

    for name in ("r_c", "r_i", "r_b", "r_r", "r_f", "c_d", "r_sense"):
        assert schematic.shown(name) in text, name
    assert schematic.shown("r_r") == "6.65k"


def test_figure_of_the_studies_has_ten_panels(tmp_path):
    program("ngspice")
    figures.drawn(tmp_path / "studies.svg")
    text = (tmp_path / "studies.svg").read_text()

    assert len(re.findall(r'id="axes_\d+"', text)) == 10
    assert "Wrong resistance" in text


def test_page_names_every_part_of_the_netlist_that_is_bought():
    page = (DOCS / "hardware.md").read_text()
    sheets = " ".join(one.source for one in VALUES.values() if one.source.startswith("sheet"))
    parts = set(re.findall(r"\b(?:OPA|AD|DAC)\d{3,4}", sheets))

    assert {"OPA192", "OPA549", "AD8421", "AD8278"} <= parts
    for part in parts:
        assert part in page, part
