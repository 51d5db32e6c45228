"""Options and steps that verbs with figures share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapticd.cli import output

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SceneName = Annotated[str, typer.Argument(metavar="SCENE", help="A shipped scene, or a path to a .toml file.")]
Plot = Annotated[bool, typer.Option("--plot/--no-plot", help="Draw a figure, PNG and SVG.")]
Out = Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Where figures go.")]
HERE = Path()


def need_figures(wanted: bool) -> None:
    """Fail before the work rather than after it: ConfigError if figures are wanted and matplotlib is missing."""
    if wanted:
        from hapticd.report import style

        with style.styled():
            pass


def keep(figure: "Figure", folder: Path, name: str, as_json: bool) -> list[str]:
    """Save NAME.png and NAME.svg and say where; the paths."""
    from hapticd.report import style

    paths = [str(path) for path in style.save(figure, folder, name)]
    if not as_json:
        output.talk(f"drawn: {', '.join(paths)}")
    return paths
