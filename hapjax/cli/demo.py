"""`hapjax demo`."""

from pathlib import Path


def demo(out: Path = Path("hapjax-demo"), seed: int = 0) -> int:
    """Grasp a cube with virtual fingers in real time, record it, and find its numbers again from the recording.

    A three-finger lift and a two-finger swing at 1 kHz, 13 s; then a fit of mu, stiffness, A_crit, mass and
    principal inertia from starts a factor 2 off. Example: hapjax demo --out hapjax-demo

    Args:
        out: Folder for the recordings, the scenes, the figures and the report.
        seed: Of the sensors' noise and of the starts, 0 or above.
    """
    from ..at_once import compute_at_once
    from ..demo import run_demo

    compute_at_once()
    return run_demo(out, seed)
