"""The solid within a closed surface of triangles."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .. import safe
from .._validate import as_float, check_number, check_positive, flag, is_traced
from ._creases import Creases, creases_of
from ._grid import Grid, grid_of
from ._hold import hold, pseudonormal, unit_normal
from ._planes import corner_of, frozen, holding
from ._shape import Corner, Edges, Shape, SurfacePoint, Track, begin, ease
from ._solid import Solid, solid_of
from ._table import rows
from ._topology import Topology, checked, topology
from ._triangle import dot, nearest_part, nearest_point, weights


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

    The force is differentiable in `vertices`, and `volume`, `centre` and `inertia_per_mass` are through `moved`. They
    are stored, as is the grid for first touch: to move vertices take `moved`, and not `eqx.tree_at`.

    **Raises:** `InputError`: a sentence that says what is wrong with the surface (not watertight, winding not
    consistent or inward, triangles under 1e-12 m^2 or there twice), of how many triangles, and of which first.
    """

    vertices: Float[Array, "V 3"]
    scale: Float[Array, ""]
    topology: Topology
    grid: Grid
    solid: Solid
    creases: Creases
    shaded: bool = eqx.field(static=True)
    file: str | None = eqx.field(static=True)

    def __init__(
        self, vertices: Any, triangles: Any, scale: Any = 1.0, shaded: Any = False, file: str | None = None
    ):
        self.scale = as_float(scale)
        check_positive("scale", self.scale, unit="")
        points, faces = checked(vertices, triangles, 1.0 if is_traced(self.scale) else float(self.scale))
        given = as_float(vertices)
        self.vertices = jnp.asarray(points, given.dtype if isinstance(given, jax.Array) else None)
        dtype = self.vertices.dtype
        self.scale = jnp.asarray(self.scale, dtype)
        self.topology = topology(points, faces, dtype)
        self.grid = grid_of(points, faces, dtype)
        self.solid = solid_of(self.vertices[faces])
        self.creases = creases_of(points, faces, dtype)
        self.shaded = flag("shaded")(shaded)
        self.file = file

    @property
    def faces(self) -> tuple[str, ...]:
        """The numbers of the triangles."""
        return tuple(map(str, range(self.topology.triangles.shape[0])))

    @property
    def triangles(self) -> Int[Array, "T 3"]:
        """The vertices of each triangle."""
        return self.topology.triangles.astype(jnp.int32)

    def moved(self, vertices: Any) -> "Mesh":
        """The same triangles with other `vertices` (V, 3), m, before the scale.

        Where the vertices are traced, as within a derivative, the grid stays that of the old ones: right for the
        derivative there, and for changes well under the size of a triangle.
        """
        vertices = as_float(vertices)
        check_number("vertices", vertices, "three finite numbers a vertex", shape=self.vertices.shape)
        if is_traced(vertices):
            solid = solid_of(vertices[self.triangles])
            return eqx.tree_at(lambda mesh: (mesh.vertices, mesh.solid), self, (vertices, solid))
        vertices = jnp.asarray(vertices, self.vertices.dtype)
        points, faces = checked(vertices, self.triangles, float(self.scale))
        dtype = vertices.dtype
        leaves = (
            vertices,
            topology(points, faces, dtype),
            grid_of(points, faces, dtype),
            solid_of(vertices[faces]),
            creases_of(points, faces, dtype),
        )
        moved = eqx.tree_at(
            lambda mesh: (mesh.vertices, mesh.topology, mesh.grid, mesh.solid, mesh.creases), self, leaves
        )
        object.__setattr__(moved, "file", None)  # it is no longer what the file says
        return moved

    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the mesh's frame), of all triangles; see `Shape.closest`."""
        return self._near(self._nearest(query), query)

    def start(self, query: Float[Array, "3"]) -> Track:
        """A point that appears inside is held by the nearest triangle."""
        triangle = self._nearest(query)
        track = begin(self._near(triangle, query), query)
        return Track(track.query, track.stretch, triangle.astype(query.dtype))

    def follow(self, track: Track, query: Float[Array, "3"]) -> tuple[Track, SurfacePoint]:
        """The local closest point downhill from where the point was held, or came in; see `Shape.follow`."""
        still = frozen(self)
        start, end = frozen((track.query / self.scale, query / self.scale))
        # The stretch outlives the contact by a little (see `ease`); then the face is kept as -1 - face.
        last = frozen(track.face).astype(jnp.int32)
        in_contact = jnp.any(frozen(track.stretch) != 0) & (last >= 0)
        last = jnp.where(last < 0, -1 - last, last)
        triangle, held = hold(still.grid, still.topology, still._corners, start, end, last, in_contact)
        near = self._near(triangle, query)
        near = eqx.tree_at(lambda n: n.depth, near, jnp.where(held, near.depth, 0))
        near = eqx.tree_at(
            lambda n: n.corner, near, self._corner(triangle, near, query, held), is_leaf=lambda x: x is None
        )
        track, point = ease(track, query, near)
        kept = jnp.where(held, triangle, -1 - triangle).astype(query.dtype)
        return Track(track.query, track.stretch, kept), point

    def volume(self) -> Float[Array, ""]:
        """The volume, m^3."""
        return self.scale**3 * self.solid.volume

    def centre(self) -> Float[Array, "3"]:
        """The centre of mass of the uniform solid, m."""
        return self.scale * self.solid.centre

    def inertia_per_mass(self) -> Float[Array, "3 3"]:
        """Inertia of the uniform solid about its centre of mass over its mass, m^2, along the axes of its frame."""
        return self.scale**2 * self.solid.inertia

    def points(self, facing=None) -> Float[Array, "V 3"]:
        """The vertices, m."""
        return self.scale * self.vertices

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

    def _nearest(self, query: Float[Array, "3"]) -> Int[Array, ""]:
        """The triangle nearest to `query`, of all."""
        still = frozen(self)
        seen = still.vertices[still.triangles] - frozen(query / self.scale)[None, None]

        def square(corners):
            point = nearest_point(corners, nearest_part(corners))
            return dot(point, point)

        return jnp.argmin(jax.vmap(square)(seen)).astype(jnp.int32)

    def _corners(self, triangle: Int[Array, ""]) -> Float[Array, "3 3"]:
        """The corners of a triangle, before the scale."""
        return rows(self.vertices, rows(self.topology.triangles, triangle).astype(jnp.int32))

    def _face(self, triangle: Int[Array, "*n"]) -> Int[Array, "*n"]:
        """The face that a triangle belongs to."""
        return triangle

    def _near(self, triangle: Int[Array, ""], query: Float[Array, "3"]) -> SurfacePoint:
        """The point of a triangle that is nearest to `query`, and the side of the surface that the query is on."""
        corners = self.scale * self._corners(triangle) - query[None]
        part = nearest_part(frozen(corners))
        outward = nearest_point(corners, part)
        distance = safe.norm(outward)
        own = unit_normal(corners)
        still = frozen(self)
        pseudo = pseudonormal(still.topology, still._corners, triangle, part)
        # On the surface itself the direction from the query to it is rounding error.
        clear = distance > 8 * jnp.finfo(query.dtype).eps * jnp.max(jnp.abs(query))
        side = jnp.where(dot(outward, pseudo) >= 0, 1, -1).astype(query.dtype)
        flat = part == 0
        normal = jnp.where(flat, own, jnp.where(clear, side * safe.normalise(outward), pseudo))
        depth = jnp.where(flat, dot(own, corners[0]), jnp.where(clear, side * distance, dot(pseudo, outward)))
        if self.shaded:
            blend = weights(corners, part)
            ids = rows(self.topology.triangles, triangle).astype(jnp.int32)
            mixed = safe.normalise(jnp.sum(blend[:, None] * rows(self.topology.vertex_normals, ids), axis=0))
            normal = jnp.where(jnp.any(mixed != 0), mixed, normal)
        return SurfacePoint(query + outward, normal, depth, self._face(triangle))

    def _corner(self, triangle, near: SurfacePoint, query, held) -> Corner | None:
        """The planes that hold the point at once. Shading has none: its normal is not theirs."""
        if self.shaded:
            return None
        still = frozen(self)
        place = frozen(query / self.scale)
        part = nearest_part(still._corners(triangle) - place[None])
        planes = holding(still.topology, still._corners, triangle, part, place, held)
        normals = jax.vmap(lambda i: unit_normal(self._corners(i)))(planes)
        count = jnp.where(part == 0, 1, jnp.where(part < 4, 2, 3))
        return corner_of(normals, self._face(planes), count, near.normal, near.face)
