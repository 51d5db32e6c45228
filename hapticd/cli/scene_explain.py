"""What a scene consists of, why, and what it costs."""

from hapticd.cli import drawing, options, output


def command(scene: drawing.SceneName, as_json: options.Json = False) -> None:
    """Say what a scene simulates: states, nonlinearities, time constants, step, why each is there, and its measured cost."""
    import time

    from hapticd.measure.accuracy import cost
    from hapticd.measure.scenes import SUBSTEPS
    from hapticd.measure.store import plain
    from hapticd.plant.compose import compose
    from hapticd.plant.stability import explain
    from hapticd.report import study as words
    from hapticd.report.table import text
    from hapticd.settings.scene import load_scene

    loaded = load_scene(scene)
    found = explain(compose(loaded), sorted({step.level_ns_per_m for step in loaded.damping}))
    spent = cost(loaded, scene, time.process_time_ns)
    if as_json:
        head = {"ok": True, "simulated": True, "scene": loaded.name, "title": loaded.title, "device": loaded.device}
        output.data_json({**head, **plain(found), "cost": plain(spent), "substeps": SUBSTEPS})
        return
    output.data(
        f"{loaded.title}: SIMULATED {loaded.device}, {len(found.states)} states, {len(found.nonlinearities)} nonlinearities"
    )
    for part in words.explained(found):
        output.data(f"\n{text(part)}")
    output.data("")
    for line in (*words.step_words(found, loaded, SUBSTEPS), *words.cost_words(spent)):
        output.data(line)
