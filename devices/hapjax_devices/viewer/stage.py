"""The scene as it is drawn: objects, fingers, a hand, and what they do to each other."""

from typing import Any

import numpy as np
from trimesh.creation import cylinder, icosphere

from hapjax import Scene
from hapjax.shape import Plane

from .geometry import from_z, placed, ring, rods
from .hand import hand
from .moments import Moments
from .shapes import as_light, glb, triangles

FINGERS = ((31, 119, 180), (230, 97, 1), (44, 140, 70), (148, 70, 180), (200, 40, 60))  # their colours
OBJECTS = ((125, 145, 175), (185, 160, 115), (135, 165, 130), (170, 135, 160))
SKIN, DARK, GREY = (226, 184, 158), (40, 40, 45), (150, 150, 155)
HOLDS, SLIDES = (30, 150, 60), (205, 30, 30)
FORCE = 0.01  # m that is drawn for each N
PATCH = 8.0  # by how much larger than life contact patches are drawn: mu times the depth is less than a millimetre
HIP, GOD = 0.0009, 0.0013  # m, radii: they are few millimetres apart, and the line between them is to be seen
TIP, JOINT, BONE = 0.006, 0.006, 0.005  # m, radii
CLEAR = 0.35  # opacity of the fingertips, in which HIPs and god-objects are
_ABOVE = 4e-4  # m, by which flat things lie on a surface
_STILL = np.array([1.0, 0.0, 0.0, 0.0])


class Stage:
    """Everything that is drawn of a scene in a viser server.

    **Arguments:** `server`; `scene`; how many `fingers`.

    **Attributes:** `tips`, the fingertips, and `palm`, for what a mouse does to them; `parts`, what there is by what it is
    called, to be hidden.
    """

    def __init__(self, server: Any, scene: Scene, fingers: int):
        self._scene, self._fingers = server.scene, fingers
        self._objects = [
            self._object(name, thing, OBJECTS[index % len(OBJECTS)])
            for index, (name, thing) in enumerate(scene.object.items())
        ]
        colours = np.array([FINGERS[finger % len(FINGERS)] for finger in range(fingers)], np.uint8)
        touches = len(scene.touchable()) * fingers
        self._hips = self._balls("hips", HIP, colours)
        self._gods = self._balls("god_objects", GOD, np.array([DARK] * touches, np.uint8))
        self._pulls = server.scene.add_line_segments(
            "/pulls", np.zeros((fingers, 2, 3)), DARK, thickness=0.0006
        )
        self._friction = server.scene.add_line_segments(
            "/friction", np.zeros((touches, 2, 3)), SLIDES, thickness=0.0009
        )
        self._forces = server.scene.add_arrows(
            "/forces",
            np.zeros((fingers, 2, 3)),
            as_light(colours),
            shaft_radius=0.0009,
            head_radius=0.003,
            head_length=0.006,
        )
        self._circles = self._flat("friction_circles", ring(0.93), touches, 1.0)
        self._patches = self._flat("contact_patches", ring(0.0), touches, 0.45)
        self._critical = self._flat("critical_areas", ring(0.96), touches, 0.9)
        self.hand = server.scene.add_frame("/hand", show_axes=False)
        self.tips = self._balls("hand/tips", TIP, colours, CLEAR)
        self._joints = self._balls("hand/joints", JOINT, np.array([SKIN] * 2 * fingers, np.uint8), 0.6)
        self._bones = self._rods(2 * fingers + 1)
        self.palm = server.scene.add_icosphere(
            "/hand/palm", 1.0, SKIN, scale=(0.032, 0.026, 0.014), opacity=0.75
        )

        self.parts = {
            "hand": [self.hand],
            "fingers (HIPs)": [self._hips, self._pulls],
            "god-objects": [self._gods],
            f"forces, {1e3 * FORCE:g} mm for 1 N": [self._forces],
            "friction circles, as large as forces": [self._circles, self._friction],
            f"contact patches and A_crit, {PATCH:g} times as large": [self._patches, self._critical],
        }

    def show(self, now: Moments) -> None:
        """Draw a moment, the last of those given."""
        pose, tips = now.pose[-1], now.tip[-1]
        for handle, place in zip(self._objects, pose, strict=True):
            handle.position, handle.wxyz = _seen(place[:3]), _seen(place[3:])
        point, normal = now.point[-1].reshape(-1, 3), now.normal[-1].reshape(-1, 3)
        there = (now.depth[-1].ravel() > 0)[:, None]
        _put(self._hips, now.hip[-1])
        _put(self._gods, point, scales=there)
        self._pulls.points = _seen(np.stack([now.hip[-1], tips], axis=1))
        self._friction.points = _seen(
            np.stack([point, point + FORCE * now.friction[-1].reshape(-1, 3)], axis=1)
        )
        self._forces.points = _seen(np.stack([tips, tips + FORCE * now.force[-1]], axis=1))
        self._show_flat(now, point, normal)
        self._show_hand(tips)

    def _show_flat(self, now: Moments, point: np.ndarray, normal: np.ndarray) -> None:
        """The friction circles, the contact patches and A_crit, flat on the surfaces."""
        limit, felt = now.limit[-1].ravel(), np.linalg.norm(now.friction[-1].reshape(-1, 3), axis=1)
        slides = (felt > 0.999 * limit) & (limit > 0)
        turn = from_z(normal)
        _put(self._circles, point + 3 * _ABOVE * normal, turn, FORCE * limit[:, None])
        self._circles.batched_colors = np.where(slides[:, None], as_light(SLIDES), as_light(HOLDS))
        circle, critical = now.circle[-1].ravel(), now.critical_area[-1]
        _put(self._patches, point + _ABOVE * normal, turn, PATCH * circle[:, None])
        there = np.where(circle > 0, 0.0 if np.isnan(critical) else np.sqrt(critical / np.pi), 0.0)
        _put(self._critical, point + 2 * _ABOVE * normal, turn, PATCH * there[:, None])
        holds = np.pi * circle**2 >= critical
        self._critical.batched_colors = np.where(holds[:, None], as_light(HOLDS), as_light(GREY))

    def _show_hand(self, tips: np.ndarray) -> None:
        shape = hand(tips)
        _put(self.tips, tips)
        _put(self._joints, shape.joints.reshape(-1, 3))
        middle, turn, length = rods(shape.bones)
        _put(self._bones, middle, turn, np.stack([np.ones_like(length)] * 2 + [length], axis=1))
        self.palm.position = _seen(shape.palm)

    def _object(self, name: str, thing: Any, colour: tuple[int, int, int]) -> Any:
        if isinstance(thing.shape, Plane):
            grid: Any = dict(width=0.6, height=0.6, cell_size=0.01, section_size=0.05, cell_thickness=0.5)
            grid |= dict(plane_color=(232, 232, 228), plane_opacity=0.6, shadow_opacity=0.25)
            return self._scene.add_grid(f"/objects/{name}", **grid)
        return self._scene.add_glb(f"/objects/{name}", glb(thing, colour))

    def _balls(self, name: str, radius: float, colours: np.ndarray, opacity: float | None = None) -> Any:
        ball, count = icosphere(3, radius), len(colours)
        return self._batch(
            name, ball.vertices, ball.faces, count, batched_colors=as_light(colours), opacity=opacity
        )

    def _flat(self, name: str, form: tuple[np.ndarray, np.ndarray], count: int, opacity: float) -> Any:
        looks: Any = dict(opacity=opacity, side="double", cast_shadow=False, receive_shadow=False)
        return self._batch(name, *form, count, batched_colors=np.tile(as_light(HOLDS), (count, 1)), **looks)

    def _rods(self, count: int) -> Any:
        rod = cylinder(BONE, 1.0, sections=24)
        return self._batch(
            "hand/bones", rod.vertices, rod.faces, count, batched_colors=as_light(SKIN), opacity=0.6
        )

    def _batch(self, name: str, vertices: np.ndarray, faces: np.ndarray, count: int, **looks: Any) -> Any:
        return self._scene.add_batched_meshes_simple(
            f"/{name}",
            np.asarray(vertices),
            np.asarray(faces),
            np.tile(_STILL, (count, 1)),
            np.zeros((count, 3)),
            batched_scales=np.ones((count, 3), np.float32),
            lod="off",
            **looks,
        )


def _put(handle: Any, places: np.ndarray, turns: np.ndarray | None = None, scales: Any = None) -> None:
    """Put a batch of things where they are, (n, 3) m, turned, and of such sizes, (n, 1) or (n, 3)."""
    handle.batched_positions = _seen(places)
    if turns is not None:
        handle.batched_wxyzs = _seen(turns)
    if scales is not None:
        handle.batched_scales = _seen(np.broadcast_to(scales, places.shape))


def _seen(numbers: Any) -> np.ndarray:
    """Numbers as far as they can be seen, to a micrometre: a page is drawn anew where one changes, and only there."""
    return np.round(np.asarray(numbers, np.float64), 6).astype(np.float32)


def camera(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """From where, and at what, to look: at all that is bounded, from the front, so that fingers from both sides in x are
    seen."""
    spots = []
    for thing in scene.object.values():
        pose = np.concatenate([np.asarray(thing.position), np.asarray(thing.orientation)])
        pose[3:] /= np.linalg.norm(pose[3:])
        bounded = not isinstance(thing.shape, Plane)
        spots.append(placed(pose, triangles(thing.shape)[0] if bounded else np.zeros((1, 3))))
    seen = np.concatenate(spots)
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, size = (low + high) / 2 + [0, 0, 0.03], max(0.12, float(np.linalg.norm(high - low)))
    return middle + 2.7 * size * np.array([0.15, -0.9, 0.42]), middle
