"""`hapjax view`."""

from pathlib import Path

from tyro.conf import Positional

from ..extras import need
from ..progress import following
from .run import HOST, PORT


def view(
    recording: Positional[Path], *, scene: Path | None = None, host: str = HOST, port: int = PORT
) -> int:
    """Play a recording back on a page in the browser, with a time bar, until Ctrl-C.

    Example: hapjax view lift.mcap

    Args:
        recording: Recording (.npz, .csv, .mcap, .parquet) with the channel hip (m).
        scene: Scene file (TOML); absent: the scene that hapjax run has recorded with it.
        host: Address of the page; on another than 127.0.0.1 anyone who reaches it sees it.
        port: Port of the page, 0 for any that is free.
    """
    with following(None, doing="loading the library"):
        need("hapjax_devices.viewer", "devices").check(host, port)
        viewer = need("hapjax_devices.viewer.replay", "viewer")
    return viewer.replay(recording, scene, host, port)
