"""The largest electrical damping that a scene bears."""

from hapticd.cli import drawing, options, output


def command(scene: drawing.SceneName, as_json: options.Json = False) -> None:
    """Say the largest stable added damping: of the device alone, with the scene's environment, and hot or cold."""
    from hapticd.measure.scene_run import ceiling
    from hapticd.measure.store import plain
    from hapticd.report.study import ceiling_table, ceiling_words
    from hapticd.report.table import text
    from hapticd.settings.scene import load_scene

    loaded = load_scene(scene)
    found = ceiling(loaded)
    if as_json:
        output.data_json({"ok": True, "simulated": True, "scene": loaded.name, "unit": "N s/m", **plain(found)})
        return
    output.data(f"{loaded.title}: SIMULATED {loaded.device}\n")
    for line in ceiling_words(found):
        output.data(line)
    if found.warmer:
        output.data(f"\n{text(ceiling_table(found))}")
