"""Recordings side by side: in batches, and over the devices of one process or of several."""

import os
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

T = TypeVar("T", bound=Any)
_AXIS = "recordings"
_REPLICATED, _APART = PartitionSpec(), PartitionSpec(_AXIS)


@dataclass(frozen=True)
class Layout:
    """Over which devices stacked recordings are spread, and how many of the first there are: the rest fills up."""

    mesh: Mesh
    count: int


def mesh_for(recordings: int) -> Mesh | None:
    """The devices for so many recordings, those of all processes; `None`: one alone."""
    devices, processes = jax.devices(), jax.process_count()
    if devices[0].platform == "cpu":
        # A CPU's devices wait for each other on threads of one pool, and for ever if the pool is not larger than that.
        each_has = 1 if processes > 1 else max(1, _threads() // 2)
        devices = [d for own in _by_process(devices) for d in own[:each_has]]
    if processes == 1:
        devices = devices[:recordings]
    return Mesh(np.array(devices), (_AXIS,)) if len(devices) > 1 else None


def _by_process(devices: Sequence[Any]) -> list[list[Any]]:
    found: dict[int, list[Any]] = {}
    for device in devices:
        found.setdefault(device.process_index, []).append(device)
    return list(found.values())


def _threads() -> int:
    """How many XLA runs a program on."""
    schedulable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return int(os.environ.get("NPROC") or schedulable)


def over_devices(groups: Sequence[T]) -> tuple[T, ...]:
    """Groups of stacked recordings, each with a field `layout`, spread over all devices; with one device, as they are."""
    sizes = [jax.tree.leaves(group)[0].shape[0] for group in groups]
    mesh = mesh_for(max(sizes))
    if mesh is None:
        return tuple(groups)
    return tuple(
        replace(_spread(group, mesh), layout=Layout(mesh, size))
        for group, size in zip(groups, sizes, strict=True)
    )


def _spread(stacked: T, mesh: Mesh) -> T:
    """Filled up with the last one so that each device has as many."""
    sharding = NamedSharding(mesh, _APART)

    def one(leaf):
        whole = np.asarray(leaf)
        whole = np.concatenate([whole, np.repeat(whole[-1:], -len(whole) % mesh.size, axis=0)])
        return jax.make_array_from_callback(whole.shape, sharding, lambda part: whole[part])

    return jax.tree.map(one, stacked)


def each(
    one: Callable[[Any, Any], Any],
    shared: Any,
    stacked: Any,
    layout: Layout | None,
    at_once: int | None = None,
) -> Any:
    """`one(shared, recording)` of each of the stacked recordings, each device working on its own; `at_once` of them side
    by side, as many as there are if `None`."""

    def some(shared, stacked):
        return _in_batches(jax.vmap(partial(one, shared)), stacked, at_once)

    if layout is None:
        return some(shared, stacked)
    # What varies over devices is not told apart in types: a scene's rollout begins with constants.
    over_devices = jax.shard_map(
        some, mesh=layout.mesh, in_specs=(_REPLICATED, _APART), out_specs=_APART, check_vma=False
    )
    return jax.tree.map(lambda x: x[: layout.count], over_devices(shared, stacked))


def _in_batches(every: Callable[[Any], Any], stacked: Any, at_once: int | None) -> Any:
    """Batches of one size, so that the program holds `every` once: the last takes some from the one before again."""
    count = jax.tree.leaves(stacked)[0].shape[0]
    batches = 1 if at_once is None else -(-count // at_once)
    if batches == 1:
        return every(stacked)
    size = -(-count // batches)
    again = batches * size - count

    def batch(first):
        return every(jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, size), stacked))

    found = jax.lax.map(batch, jnp.minimum(size * jnp.arange(batches), count - size))

    def joined(x):
        return jnp.concatenate([x[:-1].reshape(-1, *x.shape[2:]), x[-1, again:]])

    return jax.tree.map(joined, found)


def shared_out(one: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """`one(item)` of each, in their order, each process working on its part; for what is not a program of arrays."""
    count = jax.process_count()
    mine = [one(item) for item in items[jax.process_index() :: count]]
    if count == 1:
        return mine
    from jax.experimental.multihost_utils import process_allgather

    words = pickle.dumps(mine)
    lengths = process_allgather(np.array(len(words)))
    told = process_allgather(np.frombuffer(words.ljust(lengths.max(), b"\0"), np.uint8))
    parts = [pickle.loads(row[:length].tobytes()) for row, length in zip(told, lengths, strict=True)]
    return [parts[i % count][i // count] for i in range(len(items))]


def gathered(array: Any) -> np.ndarray:
    """The values of an array that may lie on devices of other processes, which all ask for it at once."""
    if isinstance(array, jax.Array) and not (array.is_fully_addressable or array.is_fully_replicated):
        everywhere = NamedSharding(array.sharding.mesh, _REPLICATED)  # pyright: ignore[reportAttributeAccessIssue]
        array = jax.jit(_same, out_shardings=everywhere)(array)
    return np.asarray(array)


def _same(array):
    return array
