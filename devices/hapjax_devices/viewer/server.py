"""The web server of a viewer: where it listens, and how its page looks."""

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

import numpy as np
import viser

from .process import check

FIELD_OF_VIEW = 0.75  # rad


@contextmanager
def serving(title: str, host: str, port: int, camera: tuple[np.ndarray, np.ndarray]) -> Iterator[Any]:
    """A viser server at an address, until the block ends; says on stdout where it is.

    **Arguments:** `title` of its panel; `port`, 0: any that is free; `camera`: where it is at first and what it looks at, m.

    **Raises:** `InputError` where that cannot be listened at.
    """
    check(host, port)
    with redirect_stdout(io.StringIO()):  # it would say where, in a box, and at its end that it stops
        server = viser.ViserServer(host, port, verbose=False)
    try:
        server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        server.gui.set_panel_label(title)
        server.gui.main_panel.dock_right()
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.set_up_direction("+z")
        server.initial_camera.position, server.initial_camera.look_at = camera
        server.initial_camera.fov, server.initial_camera.near = FIELD_OF_VIEW, 1e-3
        shown = f"[{host}]" if ":" in host else host
        print(f"the viewer is at http://{shown}:{server.get_port()}", flush=True)
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()
