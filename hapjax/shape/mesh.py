"""The solid within a closed surface of triangles."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .. import safe
from .._memory import empty, give_back
from .._segments import decided
from .._validate import as_float, check_number, check_positive, flag, is_traced
from ..errors import InputError
from ._closed import checked
from ._creases import Creases, creases_of
from ._grid import Grid, cells_met, grid_of
from ._hold import hold, pseudonormal, unit_normal
from ._local import others
from ._planes import corner_of, frozen, holding
from ._shape import Corner, Edges, Shape, SurfacePoint, Track, begin, ease
from ._solid import Solid, solid_of
from ._table import rows
from ._topology import Topology, across_of, topology, vertex_normals
from ._touching import Touching, touching_of
from ._tree import Tree, boxes_for, nearest, tree_of
from ._triangle import dot, nearest_part, nearest_point, weights

CONTACT_POINTS = 256


class Mesh(Shape):
    """The solid within a closed surface of triangles. In a step it costs about the same whatever its size.

    **Arguments:**

    - `vertices` (V, 3): m, times `scale`.
    - `triangles` (T, 3): the numbers of their vertices, counter-clockwise seen from outside. Each is a face, named by its
      number, that can have a mu of its own.
    - `scale`: above 0. It is a number like any other: with it a mesh's size is fitted.
    - `shaded`: whether the force's direction is interpolated between the vertices, so that a tessellated smooth surface
      feels smooth (Melder and Harwin 2005); the depth stays that of the triangles.
    - `file`: where it was loaded from, see `load_mesh`.
    - `contact_points`: so many vertices touch other objects at most, 4 or more. Where there are more vertices, those are
      chosen that keep the form best, and the object can sink in by `bulge` between them. Fingers feel all triangles.

    The force is differentiable in `vertices`, and `volume`, `centre` and `inertia_per_mass` are through `moved`. They
    are stored, as is all that is searched, and the contact points: to move vertices take `moved`, and not `eqx.tree_at`.

    **Raises:** `InputError`: a sentence that says what is wrong with the surface (not watertight, winding not
    consistent or inward, triangles under 1e-12 m^2 or there twice), of how many triangles, and of which first.
    """

    vertices: Float[Array, "V 3"]
    scale: Float[Array, ""]
    topology: Topology
    grid: Grid
    solid: Solid
    creases: Creases
    tree: Tree
    touching: Touching
    shaded: bool = eqx.field(static=True)
    file: str | None = eqx.field(static=True)
    contact_points: int = eqx.field(static=True)

    def __init__(
        self,
        vertices: Any,
        triangles: Any,
        scale: Any = 1.0,
        shaded: Any = False,
        file: str | None = None,
        contact_points: Any = CONTACT_POINTS,
    ):
        self.scale = as_float(scale)
        check_positive("scale", self.scale, unit="")
        points, faces = checked(vertices, triangles, 1.0 if is_traced(self.scale) else float(self.scale))
        given = as_float(vertices)
        self.vertices = jnp.asarray(points, given.dtype if isinstance(given, jax.Array) else None)
        del given  # as large as the mesh
        dtype = self.vertices.dtype
        self.scale = jnp.asarray(self.scale, dtype)
        self.contact_points = _number(contact_points)
        parts = _parts(points, faces, self.vertices, self.contact_points)
        self.topology, self.grid, self.solid, self.creases, self.tree, self.touching = parts
        self.shaded = flag("shaded")(shaded)
        self.file = file

    @property
    def faces(self) -> tuple[str, ...]:
        """The numbers of the triangles."""
        return tuple(map(str, range(self.topology.patches.shape[0])))

    @property
    def triangles(self) -> Int[Array, "T 3"]:
        """The vertices of each triangle."""
        return self.topology.patches[:, 4].astype(jnp.int32)

    def moved(self, vertices: Any) -> "Mesh":
        """The same triangles with other `vertices` (V, 3), m, before the scale.

        Where the vertices are traced, as within a derivative, the grid stays that of the old ones: right for the
        derivative there, and for changes well under the size of a triangle.
        """
        vertices = as_float(vertices)
        check_number("vertices", vertices, "three finite numbers a vertex", shape=self.vertices.shape)
        if is_traced(vertices):
            corners = vertices[self.triangles]
            patches = self.topology.patches.at[:, :3].set(corners)
            normals = vertex_normals(vertices, self.triangles)
            return eqx.tree_at(
                lambda mesh: (mesh.vertices, mesh.solid, mesh.topology.patches, mesh.topology.vertex_normals),
                self,
                (vertices, solid_of(corners), patches, normals),
            )
        vertices = jnp.asarray(vertices, self.vertices.dtype)
        points, faces = checked(vertices, self.triangles, float(self.scale))
        parts = _parts(points, faces, vertices, self.contact_points)
        moved = eqx.tree_at(
            lambda m: (m.vertices, m.topology, m.grid, m.solid, m.creases, m.tree, m.touching),
            self,
            (vertices, *parts),
        )
        object.__setattr__(moved, "file", None)  # it is no longer what the file says
        return moved

    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the mesh's frame), of all triangles; see `Shape.closest`."""
        return self._near(self._nearest(query), query)

    def closest_within(
        self, query: Float[Array, "3"], wanted: Bool[Array, ""]
    ) -> tuple[SurfacePoint, Bool[Array, ""]]:
        """As `closest`, and whether it was found: it is looked for where it is `wanted`, as far away as a quarter of the
        diagonal of the mesh's box."""
        triangle = self._search(query, self._sight(), wanted)
        return self._near(jnp.maximum(triangle, 0), query), triangle >= 0

    @property
    def is_hollow(self) -> bool:
        """Whether the surface bends inward somewhere, or is in pieces: a ball may touch it in several places at once."""
        return self.tree.cones is not None

    def walls(
        self, query: Float[Array, "3"], reach: Float[Array, ""]
    ) -> tuple[SurfacePoint, Bool[Array, "3"]]:
        """As `closest`, and up to two other points of a hollow surface at which a ball about `query` can touch it as well,
        and which of the three were found. The two are locally closest, within `reach` (m) of the query.

        Each lies above the planes of those nearer to the query; what is below belongs to the wall that has the plane.
        """
        first = self._nearest(query)
        near = self._near(first, query)
        outward = frozen(near.point - query)
        side = jnp.where(frozen(near.depth) > 0, -1, 1).astype(query.dtype)
        still, place = frozen((self, query / self.scale))
        more = others(
            still.tree, still.topology, place, frozen(reach / self.scale), outward / still.scale, side
        )
        beside = jax.vmap(lambda triangle: self._near(triangle, query))(jnp.maximum(more, 0))
        every = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), near, beside)
        return every, jnp.concatenate([jnp.ones(1, bool), more >= 0])

    def sight(self) -> Float[Array, ""]:
        """How far away (m) what may touch soon is looked for: a quarter of the diagonal of the mesh's box."""
        return frozen(self.scale) * self._sight()

    def start(self, query: Float[Array, "3"]) -> Track:
        """A point that appears inside is held by the nearest triangle."""
        triangle = self._nearest(query)
        track = begin(self._near(triangle, query), query)
        planes = jnp.zeros((4, 3), query.dtype) if self._has_corners else None
        return Track(track.query, track.stretch, triangle.astype(query.dtype), planes)

    def follow(self, track: Track, query: Float[Array, "3"]) -> tuple[Track, SurfacePoint]:
        """The local closest point downhill from where the point was held, or came in; see `Shape.follow`."""
        still = frozen(self)
        start, end = frozen((track.query / self.scale, query / self.scale))
        # The stretch outlives the contact by a little (see `ease`); then the face is kept as -1 - face.
        last = frozen(track.face).astype(jnp.int32)
        in_contact = jnp.any(frozen(track.stretch) != 0) & (last >= 0)
        last = jnp.where(last < 0, -1 - last, last)
        triangle, held = decided(hold(still.grid, still.topology, start, end, last, in_contact))
        near = self._near(triangle, query)
        near = eqx.tree_at(lambda n: n.depth, near, jnp.where(held, near.depth, 0))
        near = eqx.tree_at(
            lambda n: n.corner, near, self._corner(triangle, near, query, held), is_leaf=lambda x: x is None
        )
        track, point = ease(track, query, near)
        kept = jnp.where(held, triangle, -1 - triangle).astype(query.dtype)
        return Track(track.query, track.stretch, kept, track.planes), point

    def volume(self) -> Float[Array, ""]:
        """The volume, m^3."""
        return self.scale**3 * self.solid.volume

    def centre(self) -> Float[Array, "3"]:
        """The centre of mass of the uniform solid, m."""
        return self.scale * self.solid.centre

    def inertia_per_mass(self) -> Float[Array, "3 3"]:
        """Inertia of the uniform solid about its centre of mass over its mass, m^2, along the axes of its frame."""
        return self.scale**2 * self.solid.inertia

    def points(self, facing=None) -> Float[Array, "P 3"]:
        """The vertices that touch other objects, m."""
        chosen = self.touching.vertices
        every = chosen.shape[0] == self.vertices.shape[0]
        return self.scale * (self.vertices if every else self.vertices[chosen.astype(jnp.int32)])

    def bulge(self) -> Float[Array, ""]:
        """How far (m) a vertex stands out, along its normal, over the contact points about it; 0 where all are contact
        points. By so much the mesh can sink into another object before one of its points touches."""
        return self.scale * self.touching.bulge

    def edges(self) -> Edges | None:
        """The convex edges at which the surface bends by more than 10 degrees."""
        if self.creases.vertices.shape[0] == 0:
            return None
        start, end = (self.scale * self.vertices[i.astype(jnp.int32)] for i in self.creases.vertices.T)
        corners = self.vertices[self.triangles[self.creases.triangles.astype(jnp.int32)]]
        return Edges(start, end, jax.vmap(jax.vmap(unit_normal))(corners))

    def thickness(self) -> Float[Array, ""]:
        """Volume over area: half the thickness of a plate."""
        return self.scale * self.creases.thickness

    def _sight(self) -> Float[Array, ""]:
        still = frozen(self)
        across = still.grid.high - still.grid.low
        return jnp.sqrt(dot(across, across)) / 4

    def _nearest(self, query: Float[Array, "3"]) -> Int[Array, ""]:
        """The triangle nearest to `query`, of all."""
        far, yes = jnp.full((), jnp.inf, query.dtype), jnp.ones((), bool)
        return jnp.maximum(self._search(query, far, yes), 0)

    def _search(self, query, reach, wanted) -> Int[Array, ""]:
        """The triangle nearest to `query`, m; -1 where it is farther than `reach`, before the scale."""
        still, place = frozen(self), frozen(query / self.scale)
        return nearest(still.tree, still.topology, place, reach, wanted)

    def _corners(self, patch: Float[Array, "*n 5 3"]) -> Float[Array, "*n 3 3"]:
        """The corners of a triangle, before the scale; they have the derivatives that the patch has not."""
        return rows(self.vertices, patch[..., 4, :].astype(jnp.int32))

    def _face(self, triangle: Int[Array, "*n"]) -> Int[Array, "*n"]:
        """The face that a triangle belongs to."""
        return triangle

    def _near(self, triangle: Int[Array, ""], query: Float[Array, "3"]) -> SurfacePoint:
        """The point of a triangle that is nearest to `query`, and the side of the surface that the query is on."""
        still = frozen(self)
        patch = rows(still.topology.patches, triangle)
        corners = self.scale * self._corners(patch) - query[None]
        part = nearest_part(frozen(corners))
        outward = nearest_point(corners, part)
        distance = safe.norm(outward)
        own = unit_normal(corners)
        pseudo = pseudonormal(still.topology, patch, part)
        # On the surface itself the direction from the query to it is rounding error.
        clear = distance > 8 * jnp.finfo(query.dtype).eps * jnp.max(jnp.abs(query))
        side = jnp.where(dot(outward, pseudo) >= 0, 1, -1).astype(query.dtype)
        flat = part == 0
        normal = jnp.where(flat, own, jnp.where(clear, side * safe.normalise(outward), pseudo))
        depth = jnp.where(flat, dot(own, corners[0]), jnp.where(clear, side * distance, dot(pseudo, outward)))
        if self.shaded:
            blend = weights(corners, part)
            ids = patch[4].astype(jnp.int32)
            mixed = safe.normalise(jnp.sum(blend[:, None] * rows(self.topology.vertex_normals, ids), axis=0))
            normal = jnp.where(jnp.any(mixed != 0), mixed, normal)
        return SurfacePoint(query + outward, normal, depth, self._face(triangle))

    @property
    def _has_corners(self) -> bool:
        """Whether several planes can hold a point at once. Shading has none: its normal is not theirs."""
        return not self.shaded

    def _corner(self, triangle, near: SurfacePoint, query, held) -> Corner | None:
        """The planes that hold the point at once."""
        if not self._has_corners:
            return None
        still = frozen(self)
        place = frozen(query / self.scale)
        patch = rows(still.topology.patches, triangle)
        part = nearest_part(patch[:3] - place[None])
        planes = holding(still.topology, triangle, patch, part, place, held)
        normals = jax.vmap(unit_normal)(self._corners(rows(still.topology.patches, planes)))
        count = jnp.where(part == 0, 1, jnp.where(part < 4, 2, 3))
        return corner_of(normals, self._face(planes), count, near.normal, near.face)


def _parts(
    points: np.ndarray, faces: np.ndarray, vertices: Float[Array, "V 3"], contact_points: int
) -> tuple:
    """What is found once of a checked surface; what takes most room on the way comes first."""
    dtype = vertices.dtype
    corners = empty((len(faces), 3, 3), dtype)
    corners[:] = np.asarray(vertices)[faces]
    solid = solid_of(jnp.asarray(corners, dtype))
    del corners
    across = across_of(faces, len(points))
    give_back()
    creases = creases_of(points, faces, across, dtype)
    grid = grid_of(points, faces, dtype)
    give_back()
    normals = jnp.asarray(vertex_normals(points, faces), dtype)
    touching = touching_of(points, np.asarray(normals), contact_points, dtype)
    give_back()
    tree = tree_of(points, faces, across, normals)
    give_back()
    return topology(points, faces, across, normals), grid, solid, creases, tree, touching


def room_for(vertices: np.ndarray, triangles: np.ndarray) -> int:
    """About how many bytes it takes to build a mesh in float32, beside what a small one takes; found in little room.

    Most is needed either while the grid is made, or at the end, when all there is beside it is in memory too.
    """
    count, cells = len(triangles), cells_met(vertices, triangles)
    return int(max(60 * count + 28 * cells, 140 * count + 76 * boxes_for(count) + 6 * cells))


def _number(contact_points: Any) -> int:
    if isinstance(contact_points, bool) or not isinstance(contact_points, int) or contact_points < 4:
        raise InputError(f"contact_points is {contact_points!r}; allowed: a whole number, at least 4")
    return contact_points
