"""Files of figures: all kinds, and the same bytes for the same data."""

from pathlib import Path

import pytest
from support.measured_scenes import noisy_scene

from hapticd.studies.report import scene_figure
from hapticd.studies.scene import SceneResult
from hapticd.zwidth.report import style

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def noisy() -> SceneResult:
    return noisy_scene()


def test_figure_is_kept_as_png_svg_and_pdf(tmp_path: Path, noisy: SceneResult) -> None:
    png, svg, pdf = style.save(scene_figure(noisy), tmp_path / "new", "small")
    assert png.read_bytes().startswith(PNG)
    assert svg.read_text().startswith("<?xml")
    assert pdf.read_bytes().startswith(b"%PDF")
    assert (png.name, svg.name, pdf.name) == ("small.png", "small.svg", "small.pdf")


def test_same_result_gives_the_same_bytes(tmp_path: Path, noisy: SceneResult) -> None:
    first, second = (style.save(scene_figure(noisy), tmp_path / name, "x") for name in "ab")
    assert [one.read_bytes() for one in first] == [other.read_bytes() for other in second]
