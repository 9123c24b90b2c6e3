"""Free parameters: leaves of a scene, named by the path they have in the scene file."""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import Body, InputError, Object

from .sensors import Setup, size_of, widest_of
from .start import is_start, size_of_start
from .transform import Identity, Log, Logit, Transform
from .whole_body import COUNT, SIZES, as_shown, body_of, is_whole, of_leaf, shown

# What paths begin at: a scene, a scene and how it was measured, or another tree of named parts.
Root = eqx.Module
_R = TypeVar("_R", bound=eqx.Module)
Selector = str | Sequence[str] | Callable[[Any], Any]

# What can be below zero; every other number of a scene is a positive one and is fitted through its logarithm.
_SIGNED = ("position", "orientation", "centre", "gravity", "grain")
_SIGNED += ("force_bias", "force_delay", "pose_delay", "hip_rotation")
_SMALL = 1e-2  # how far off other signed numbers are at least, in their unit
# How the scene is computed, not what it is; the recordings are laid on the integrator's time grid once.
_NOT_PHYSICAL = ("integrator",)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One free number: its path, its index in the leaf (`None`: the leaf is one number), and its transform; and which
    recording it is of, by its place and name (`None`: it is shared by all)."""

    path: str
    index: int | None
    transform: Transform
    place: int | None = None
    recording: str | None = None

    @property
    def stem(self) -> str:
        """The path, with the index in brackets where the leaf has several numbers."""
        return self.path if self.index is None else f"{self.path}[{self.index}]"

    @property
    def name(self) -> str:
        """The stem, with the recording where it is of one: `path @ recording`."""
        return self.stem if self.recording is None else f"{self.stem} @ {self.recording}"

    def answers_to(self, name: str) -> bool:
        """Whether the name is its own, or that of what it is a part of."""
        return name in (self.name, self.stem, self.path)


def size_at(parameter: Parameter, free: float, least: float = _SMALL) -> float:
    """How far off an unconstrained number may well be: 1 for a logarithm, else its size and at least `least`, or what
    is usual of a sensor."""
    if is_whole(parameter.path):
        return SIZES[parameter.index or 0]
    if is_start(parameter.path):
        return size_of_start(parameter.path)
    usual = None if isinstance(parameter.transform, Logit) else size_of(parameter.path)
    if isinstance(parameter.transform, Identity):
        return max(abs(free), least if usual is None else usual)
    return 1.0 if usual is None else usual


def scatter(
    first: Float[Array, " p"], parameters: tuple[Parameter, ...], starts: int, spread: float, seed: int
) -> Float[Array, "S p"]:
    """The first start, and others off by random factors up to `spread`; the same numbers for the same
    seed."""
    random = np.random.default_rng(seed).uniform(-1, 1, (starts, len(first)))
    random[0] = 0
    size = [size_at(p, float(x), least=0.0) for p, x in zip(parameters, first, strict=True)]
    return first[None] + jnp.asarray(np.log(spread) * random * np.array(size), first.dtype)


def moves_surface(parameter: Parameter) -> bool:
    """Whether when fingers touch an object depends on it: a number of its place or shape, or of the frame of HIP."""
    if parameter.path == "sensor.hip_rotation":
        return True
    kind, _, part, *_ = [*parameter.path.split("."), "", ""]
    return kind == "object" and part not in ("surface", "body")


def find_leaf(scene: Root, path: str) -> Float[Array, "*shape"]:
    """The leaf with a path such as `object.cube.surface.mu`. **Raises:** `InputError` where there is none."""
    if is_whole(path):
        return of_leaf(_body(scene, path))
    node = _walk(scene, path)
    if not eqx.is_array(node):
        raise InputError(
            f"{path} is a part of the scene, not a number; allowed: {_continuations(node, path.split('.'))}"
        )
    return node


def _walk(scene: Root, path: str) -> Any:
    node: Any = scene
    walked: list[str] = []
    for name in path.split("."):
        node = _child(node, name, walked, path)
        walked.append(name)
    return node


def free_parameters(
    scene: Root,
    free: Selector,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    each: Sequence[str] = (),
    recordings: Sequence[str] = (),
) -> tuple[Parameter, ...]:
    """The free numbers that paths, or a function from the scene to its leaves, select, in their order.

    A number with `bounds` is fitted through a scaled logit, others through the logarithm, positions and directions as
    they are. What `each` names has a number for each of the `recordings`. **Raises:** `InputError` for unknown paths,
    repeated ones, the integrator's numbers, and starting values outside their transform.
    """
    parameters: list[Parameter] = []
    for given in paths_of(scene, free):
        parameters += _expand(scene, given, bounds or {})
    parameters = _for_each(parameters, each, recordings, bounds or {})
    names = [p.name for p in reported(tuple(parameters))]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"free names {name} twice; allowed: each parameter once")
    for name in bounds or {}:
        if not any(p.answers_to(name) for p in parameters):
            raise InputError(f"bounds names {name}, which is not free; allowed: {', '.join(names)}")
    for parameter, value in zip(parameters, values_of(scene, tuple(parameters)), strict=True):
        parameter.transform.check(parameter.name, float(value))
    return tuple(parameters)


def _for_each(
    parameters: list[Parameter],
    each: Sequence[str],
    recordings: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
) -> list[Parameter]:
    for name in each:
        if not any(p.answers_to(name) for p in parameters):
            allowed = ", ".join(p.name for p in parameters)
            raise InputError(f"each names {name}, which is not free; allowed: {allowed}")
    for name in recordings if each else ():
        if list(recordings).count(name) > 1:
            raise InputError(
                f"names has {name} twice; allowed with each: a name of its own for each recording"
            )
    found = []
    for parameter in parameters:
        if not any(parameter.answers_to(name) for name in each):
            found.append(parameter)
            continue
        for place, recording in enumerate(recordings):
            own = dataclasses.replace(parameter, place=place, recording=recording)
            transform = _transform(own.path, own.index, bounds, own.name)
            found.append(dataclasses.replace(own, transform=transform))
    return found


def paths_of(scene: Root, free: Selector) -> list[str]:
    """The paths of what is free. **Raises:** `InputError` where there are none, or one is empty."""
    if callable(free):
        paths = _selected_paths(scene.scene if isinstance(scene, Setup) else scene, free)
    else:
        paths = [free] if isinstance(free, str) else list(free)
    if not paths:
        raise InputError("free is empty; allowed: at least one parameter's path")
    if not all(str(path).strip() for path in paths):
        raise InputError("free has an empty path; allowed: paths, such as object.cube.surface.mu")
    return paths


def values_of(scene: Root, parameters: tuple[Parameter, ...]) -> Float[Array, "p"]:
    """The parameters' values in a scene."""
    leaves = [find_leaf(scene, p.path) for p in parameters]
    return jnp.stack([x if p.index is None else x[p.index] for x, p in zip(leaves, parameters, strict=True)])


def with_values(scene: _R, parameters: tuple[Parameter, ...], values: Float[Array, "p"]) -> _R:
    """The scene, or scene and sensors, with other values of its parameters."""
    leaves = {p.path: find_leaf(scene, p.path) for p in parameters if not is_whole(p.path)}
    for i, p in enumerate(parameters):
        if is_whole(p.path):
            if p.index == 0:
                body = p.path.rsplit(".", 1)[0]
                names = (f"{body}.mass", f"{body}.centre", f"{body}.inertia")
                leaves |= dict(zip(names, body_of(values[i : i + COUNT]), strict=True))
        else:
            leaves[p.path] = values[i] if p.index is None else leaves[p.path].at[p.index].set(values[i])
    return eqx.tree_at(lambda s: [_walk(s, path) for path in leaves], scene, list(leaves.values()))


def stems_of(parameters: tuple[Parameter, ...]) -> list[list[int]]:
    """The places of parameters, those of one path of all recordings together."""
    rows: dict[str, list[int]] = {}
    for i, p in enumerate(parameters):
        rows.setdefault(p.stem, []).append(i)
    return list(rows.values())


def reported(parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """The parameters as results name them: mass, centre and inertia in place of a whole body's ten numbers."""
    found = []
    for p in parameters:
        if is_whole(p.path):
            path, index, transform = shown(p.path)[p.index or 0]
            p = dataclasses.replace(p, path=path, index=index, transform=transform)
        found.append(p)
    return tuple(found)


def report(parameters: tuple[Parameter, ...], free: Float[Array, " p"]) -> Float[Array, " p"]:
    """The unconstrained numbers of the `reported` parameters."""
    for p in parameters:
        if is_whole(p.path) and p.index == 0:
            of_body = jnp.asarray(
                [i for i, q in enumerate(parameters) if (q.path, q.place) == (p.path, p.place)]
            )
            free = free.at[of_body].set(as_shown(free[of_body]))
    return free


def _body(scene: Root, path: str) -> Body:
    node = _walk(scene, path.rsplit(".", 1)[0])
    if not isinstance(node, Body):
        raise InputError(f"{path}: only a body has one; allowed: object.NAME.body.pseudo_inertia")
    return node


def _expand(scene: Root, given: str, bounds: Mapping[str, tuple[float, float]]) -> list[Parameter]:
    match = re.fullmatch(r"(.*)\[([0-9]+)\]", given)
    path = match.group(1) if match else given
    if path.split(".")[0] in _NOT_PHYSICAL:
        raise InputError(f"{given} is not physical; allowed: {_continuations(scene, [])}")
    if is_whole(path):
        _body(scene, path)
        if match:
            raise InputError(f"{given} is not free alone; allowed: {path}, all of its ten numbers")
        if any(name.startswith(path) for name in bounds):
            raise InputError(f"bounds names {path}; allowed: priors on mass, centre and inertia")
        return [Parameter(path, i, Identity()) for i in range(COUNT)]
    shape = find_leaf(scene, path).shape
    if len(shape) > 1:
        raise InputError(
            f"{path} is a matrix; allowed: numbers and lists (give the inertia as three principal moments, "
            "or free pseudo_inertia: mass, centre and inertia together)"
        )
    if match and (len(shape) == 0 or int(match.group(2)) >= shape[0]):
        raise InputError(f"{given} is out of range; allowed: {_names(path, shape)}")
    indices: list[int | None] = (
        [int(match.group(2))] if match else (list(range(shape[0])) if shape else [None])
    )
    return [Parameter(path, i, _transform(path, i, bounds)) for i in indices]


def _names(path: str, shape: tuple[int, ...]) -> str:
    return f"{path}[0] to [{shape[0] - 1}]" if shape else path


def _transform(
    path: str, index: int | None, bounds: Mapping[str, tuple[float, float]], name: str = ""
) -> Transform:
    limits = bounds.get(name, bounds.get(f"{path}[{index}]", bounds.get(path)))
    signed = is_start(path) or path.rsplit(".", 1)[-1] in _SIGNED
    if limits is not None:
        try:
            low, high = (float(x) for x in limits)
        except (TypeError, ValueError):
            low = high = np.nan
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(f"bounds of {path} are {limits!r}; allowed: two finite numbers, the lower first")
        if low < 0 and not signed:
            raise InputError(f"bounds of {path} begin at {low:g}; allowed: 0 or above, as in a scene")
        return Logit(low, high)
    return Identity(widest_of(path)) if signed else Log()


def _child(node: Any, name: str, walked: list[str], path: str) -> Any:
    parts = _parts(node)
    if name not in parts:
        where = ".".join(walked) or "the scene"
        raise InputError(
            f"{path}: {where} has no {name or 'part without a name'}; allowed: {_continuations(node, walked)}"
        )
    if parts[name] is None:
        raise InputError(
            f"{path}: this scene leaves out {'.'.join([*walked, name])}; allowed: what the scene has"
        )
    return parts[name]


def _parts(node: Any) -> dict[str, Any]:
    """What a path can go on with; an object's shape lends it its numbers, as in the scene file."""
    if isinstance(node, Mapping):
        return dict(node)
    if isinstance(node, Setup):
        return _parts(node.scene) | {"sensor": node.sensor, "start": node.start}
    if not dataclasses.is_dataclass(node):
        return {}
    parts = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}
    return parts | _parts(parts.pop("shape")) if isinstance(node, Object) else parts


def _continuations(node: Any, walked: list[str]) -> str:
    parts = {name: part for name, part in _parts(node).items() if walked or name not in _NOT_PHYSICAL}
    names = [name for name, part in parts.items() if jax.tree.leaves(eqx.filter(part, eqx.is_array))]
    return ", ".join(".".join([*walked, n]) for n in names) or "a path to a number"


def _selected_paths(scene: Root, select: Callable[[Any], Any]) -> list[str]:
    """The paths of the leaves that a function picks: it is given the scene with each leaf replaced by its
    path."""
    leaves, structure = jax.tree_util.tree_flatten_with_path(scene)
    marks = [_Mark(_path_name(keys)) for keys, _ in leaves]
    picked = jax.tree.leaves(
        select(jax.tree.unflatten(structure, marks)), is_leaf=lambda x: isinstance(x, _Mark)
    )
    for mark in picked:
        if not isinstance(mark, _Mark):
            raise InputError(
                f"free selects {mark!r}; allowed: leaves of the scene, such as s.object['cube'].surface.mu"
            )
    return [mark.path for mark in picked]


@dataclasses.dataclass(frozen=True)
class _Mark:
    path: str


def _path_name(keys: tuple[Any, ...]) -> str:
    names = [str(k.key) if isinstance(k, jax.tree_util.DictKey) else str(getattr(k, "name", k)) for k in keys]
    return ".".join(n for i, n in enumerate(names) if not (i == 2 and names[0] == "object" and n == "shape"))
