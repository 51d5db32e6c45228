"""What is said of a trial beside its sentence: before it what is flown, below it what would decide, and how the sine compares."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hapticd.measure.referee import Referee
    from hapticd.measure.sources import Trial
    from hapticd.measure.store import Recorded
    from hapticd.measure.trial import TrialResult
    from hapticd.plant.scene import Scene


def asked_for(source: str, trial: "Trial", scene: "Scene | None", recorded: "Recorded | None") -> str:
    """What is about to be flown or read, environment and all."""
    k, b, m = trial.environment
    what = f"K {k:g} N/m, B {b:g} N s/m, M {m:g} kg, added damping {trial.damping_ns_per_m:g} N s/m"
    if recorded is not None:
        return f"reads {recorded.origin}, {recorded.seconds:.4g} s at {recorded.rate_hz:.6g} Hz, as recorded in {what}"
    device = f", device {scene.device} of scene {scene.name}" if scene else ""
    return f"flies {what} by the {source}{device}"


def needed(result: "TrialResult") -> str:
    """What would decide, as far as it can be said."""
    from math import ceil

    from hapticd.analysis import verdict as outlook

    verdict, layout = result.verdict, result.plan.params.multisine
    voiding = sorted({finding.code for finding in verdict.findings if finding.voids})
    if voiding:
        return f"no length of a record decides with {' and '.join(voiding)} in it: mend that first"
    if layout is None:
        return outlook.needed(verdict.seconds_needed, verdict.seconds)
    more = verdict.seconds_needed / verdict.seconds
    if not more <= outlook.FORESEEABLE:
        return f"many more than {layout.realisations} realisations would be needed; use noise (--excitation noise)"
    distorted = any(finding.code == "distortion" for finding in verdict.findings)
    remedy = "; where friction distorts, noise decides sooner" if distorted else ""
    return f"some {outlook.two_digits(ceil(layout.realisations * more))} realisations would decide{remedy}"


def compared(result: "TrialResult", referee: "Referee") -> str:
    """Sines and noise side by side, each frequency of `referee` a line."""
    import numpy as np

    from hapticd.report.table import table, text

    rows, moved = [], 1e3 * referee.velocity_rms_m_per_s
    for f, speed, sine in zip(referee.frequency_hz, moved, referee.impedance_ns_per_m, strict=True):
        noise = result.measured.impedance_ns_per_m[int(np.argmin(np.abs(result.measured.frequency_hz - f)))]
        sizes = (part(z) for part in (abs, lambda z: float(np.degrees(np.angle(z)))) for z in (sine, noise))
        rows.append((float(f), float(speed), *sizes))
    columns = ("Hz", "sine mm/s rms", "sine |Z| N s/m", "noise |Z|", "sine phase deg", "noise phase")
    title = f"stepped sine of {referee.force_n:g} N rms beside the noise"
    return f"{text(table(columns, rows, title))}\n{_amplitudes(result, moved[np.isfinite(moved)].tolist())}"


def _amplitudes(result: "TrialResult", sines_mm_per_s: list[float]) -> str:
    """Why sines and noise may differ, and which of them is judged."""
    noise = 1e3 * result.verdict.amplitude.velocity_sd_m_per_s
    between = f"{min(sines_mm_per_s):.3g} to {max(sines_mm_per_s):.3g}" if sines_mm_per_s else "unknown"
    return (
        f"the sines move the device at {between} mm/s rms, the noise at {noise:.3g} mm/s at all frequencies together; dry friction "
        "is another damping at each amplitude, so with it the two differ and a sine may leave +-90 deg alone; the verdict is the "
        "noise's"
    )
