"""What a recording says that cannot be so: the lies that a user can tell without knowing, each by its name.

Each check compares the recording with the scene's geometry and tells what is wrong from what is only not yet fitted:
stiffness and friction may be off by a factor of ten. A lie that was found is undone in a copy before the next check, so that
one does not show up as another. Nothing is changed in what is fitted: all is only reported.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import jax.numpy as jnp
import numpy as np

from hapjax import Finding, Recording, Scene

from .axes import axes_of
from .clocks import beside, clock_of
from .evidence import Evidence, evidence_of, scaled
from .fingers import fingers_of, unexplained
from .held import lies_of_grip
from .motion import no_slip, stuck, unreached
from .noise import correlation_time, is_quiet
from .sensors import Sensors
from .sharding import shared_out
from .tracking import untracked

_TURN = 2 * np.pi
# Each with the factor by which it must explain the stiffness better than millimetres, which are common.
_LENGTHS = {1e-3: ("millimetres", 1.0), 1e-2: ("centimetres", 3.0), 1e3: ("kilometres", 3.0)}
_FORCES = {1e-3: "millinewtons", 1e3: "kilonewtons"}
_OFF = 50.0  # by what factor a stiffness may be wrong before it is a wrong unit
_HAND = (0.02, 200.0)  # N, what fingers press with
_REACH = 3.0  # m, what no fingertip travels
_CHANCE = 6.0  # standard errors of a stiffness
_WIDE, _NARROW = 0.5, 1e-3  # m: what is taken for too large a unit, or too small a one, spans more, or less


def findings_of(
    scene: Scene,
    recordings: Sequence[Recording],
    names: Sequence[str],
    friction: bool = True,
    sensors: Mapping[str, Sensors] = MappingProxyType({}),
) -> tuple[Finding, ...]:
    """What is odd about recordings of a scene, with the evidence in a sentence each, after what loading them found.

    Of each recording: units of length, force and angle; force of the wrong sign, or along the wrong axis; fingers swapped;
    clocks shifted against each other; no contact; no force; a stuck encoder; poses that were held; and, with `friction` to
    be found, no slip.

    **Arguments:** `names`, what the recordings are called; `sensors`, how they were measured, by name: what is known of that
    is undone first.
    """
    known = [_undone(r, sensors[n]) if n in sensors else r for r, n in zip(recordings, names, strict=True)]
    told = shared_out(lambda recording: lies(scene, recording, friction), known)
    found = []
    for recording, name, of_one in zip(recordings, names, told, strict=True):
        found += [replace(finding, recording=name) for finding in (*recording.findings, *of_one)]
    return tuple(found)


def lies(scene: Scene, recording: Recording, friction: bool = True) -> list[Finding]:
    """What the scene says is wrong with a recording."""
    recording, found = beside(recording)
    found += _angles(recording)
    evidence = evidence_of(scene, recording)
    if evidence is None:
        return found + lies_of_grip(scene, recording)
    evidence, units = _units(evidence)
    found += units
    nothing = _no_contact(evidence)
    if nothing is not None:
        return [*found, nothing, *unreached(evidence)]
    if evidence.force is None:
        return found
    evidence, dealt = fingers_of(evidence)
    suspects, unseen = stuck(evidence), untracked(evidence)
    evidence, late = clock_of(evidence, suspects + unseen)
    evidence, turned = axes_of(evidence, so_read=bool(units or dealt or late))
    frozen = [each.finding for each in (stuck(evidence) if late or turned else suspects)]
    slipless = no_slip(evidence) if friction and not frozen else []
    held = [each.finding for each in unseen if not each.finger]
    return found + dealt + held + late + turned + frozen + slipless


def _undone(recording: Recording, sensors: Sensors) -> Recording:
    """What was recorded, as perfect sensors would have."""
    changed: dict[str, Any] = {}
    if recording.hip is not None and sensors.hip_rotation is not None:
        changed["hip"] = np.asarray(sensors.turned(jnp.asarray(recording.hip)))
    if recording.force is not None and recording.force_t is not None:
        if sensors.force_bias is not None or sensors.force_gain is not None:
            changed["force"] = np.asarray(sensors.corrected(jnp.asarray(recording.force)))
        changed["force_t"] = recording.force_t - float(sensors.force_delay or 0)
    if recording.pose_t is not None:
        changed["pose_t"] = recording.pose_t - float(sensors.pose_delay or 0)
    return replace(recording, **changed)


def _angles(recording: Recording):
    if recording.gimbal is None:
        return
    span = float(np.ptp(recording.gimbal, axis=0).max())
    if span > _TURN:
        sentence = (
            f"gimbal turns through {span:.4g} rad, more than a whole turn: its angles look like degrees"
        )
        yield Finding("gimbal", "angle unit", sentence)


def _units(evidence: Evidence) -> tuple[Evidence, list[Finding]]:
    """The evidence with units that make sense, and what was wrong with them."""
    if _makes_sense(evidence):
        return evidence, []
    lengths = _length(evidence)
    forces = _force(evidence)
    if lengths is None or (forces is not None and not _hand(evidence)):
        return (evidence, []) if forces is None else forces
    return lengths


def _length(evidence: Evidence) -> tuple[Evidence, list[Finding]] | None:
    """The channels that are in another unit, and which: the reading that explains the forces best."""
    recording = evidence.recording
    channels: list[tuple[str, ...]] = [("hip",)]
    if recording.pose is not None:
        channels = [("hip", "pose"), ("hip",), ("pose",)]
    read = [reading for names in channels if (reading := _unit_of(evidence, names)) is not None]
    if not read:
        return None
    left = [_unexplained(other) for _, _, other in read]
    names, unit, other = read[next(i for i, x in enumerate(left) if x <= 2 * min(left))]
    first, *more = names
    sentence = (
        f"{' and '.join(names)} {'look' if more else 'looks'} like {unit}, expected metres: it spans "
        f"{_span(getattr(recording, first)):.4g} m and, so read, {_agreement(other):.0%} of what is felt is felt where "
        "the scene's surfaces are"
    )
    return other, [Finding(first, "length unit", sentence)]


def _unit_of(evidence: Evidence, names: tuple[str, ...]) -> tuple[tuple[str, ...], str, Evidence] | None:
    """The unit that channels would be in, all alike, by the stiffness that comes out; and the evidence so read."""
    recording = evidence.recording
    span, best, read = _span(getattr(recording, names[0])), np.inf, None
    for factor, (unit, rare) in _LENGTHS.items():
        if (factor < 1 and span < _WIDE) or (factor > 1 and span > _NARROW):
            continue  # shrunk to a point, anything is inside something
        other = evidence_of(evidence.scene, scaled(recording, **dict.fromkeys(names, factor)))
        if other is not None and _makes_sense(other) and _told_apart(other):
            measured, given = _stiffness(other)
            off = rare * max(measured / given, given / measured)
            if off < best:
                best, read = off, (names, unit, other)
    return read


def _unexplained(evidence: Evidence) -> float:
    """The part of the forces' squares that places do not explain, whatever their signs."""
    force = evidence.force
    if force is None:
        return 0.0
    left = [
        min(unexplained(evidence, i, sign * force[:, i]) for sign in (1, -1)) for i in range(force.shape[1])
    ]
    return float(sum(left) / max(np.sum(force**2), 1e-300))


def _force(evidence: Evidence) -> tuple[Evidence, list[Finding]] | None:
    if evidence.force is None:
        return None
    for factor, unit in _FORCES.items():
        other = evidence_of(evidence.scene, scaled(evidence.recording, force=factor))
        if other is not None and _makes_sense(other):
            typical = float(np.median(evidence.strength[evidence.pressed]))
            times = _stiffness(evidence)[0] / _stiffness(evidence)[1]
            sentence = (
                f"force looks like {unit}, expected newtons: it is {typical:.4g} N typically, "
                f"{times:.3g} times what the scene's stiffness gives"
            )
            return other, [Finding("force", "force unit", sentence)]
    return None


def _makes_sense(evidence: Evidence) -> bool:
    """Whether lengths and forces go together: force where there is touch, of about the stiffness in the scene."""
    if evidence.force is None:
        return bool(evidence.touching.any()) and _span(evidence.recording.hip) < _REACH
    if not evidence.pressed.any():
        return True
    if _agreement(evidence) < 0.5:
        return False
    measured, given = _stiffness(evidence)
    return given / _OFF <= measured <= given * _OFF


def _told_apart(evidence: Evidence) -> bool:
    """Whether fingers mostly are in surfaces when they feel force, and out of them when not."""
    return evidence.force is None or float(np.mean(evidence.touching == evidence.pressed)) > 0.6


def _agreement(evidence: Evidence) -> float:
    """The part of the moments with force at which the finger touches something."""
    pressed = evidence.touching if evidence.force is None else evidence.pressed
    return float(np.mean(evidence.touching[pressed])) if pressed.any() else 0.0


def _stiffness(evidence: Evidence) -> tuple[float, float]:
    """What force over depth is measured and given, N/m."""
    if evidence.force is None:
        return 1.0, 1.0
    both = evidence.touching & evidence.pressed
    surfaces = [o.surface for o in evidence.scene.object.values() if o.surface is not None]
    given = float(np.median([float(surface.stiffness) for surface in surfaces]))
    measured = np.sum(evidence.strength[both]) / np.sum(evidence.places.depth[both]) if both.any() else given
    return float(measured), given


def _span(samples) -> float:
    """How far positions reach, m."""
    return float(np.ptp(samples[..., :3], axis=0).max())


def _hand(evidence: Evidence) -> bool:
    """Whether the forces are such as fingers press with."""
    typical = float(np.median(evidence.strength[evidence.pressed]))
    return _HAND[0] <= typical <= _HAND[1]


def _no_contact(evidence: Evidence) -> Finding | None:
    """Nothing touched, or nothing felt."""
    strongest = 0.0 if evidence.force is None else float(evidence.strength.max())
    if evidence.whole and not evidence.touching.any():
        nearest = float(-evidence.places.depth.max())
        felt = "" if strongest <= 5 * evidence.noise else f", though the force reaches {strongest:.3g} N"
        sentence = f"no finger touches anything of the scene: {1e3 * nearest:.4g} mm are the least between them{felt}"
        return Finding("hip", "no contact", sentence)
    if evidence.force is None:
        return None
    touching, noise = evidence.touching, evidence.noise
    quiet = is_quiet(evidence.force, noise) and not _goes_with_depth(evidence)
    if evidence.whole and quiet and touching.sum() > 20:
        sentence = (
            f"no force is above its noise, {noise:.2g} N, though fingers are in surfaces at "
            f"{touching.sum()} of {touching.size} moments"
        )
        return Finding("force", "no force", sentence)
    if quiet:
        return Finding(
            "force", "no contact", f"no force is above its noise, {noise:.2g} N: nothing was touched"
        )
    return None


def _goes_with_depth(evidence: Evidence) -> bool:
    """Whether a finger's force, but for what a sensor always shows, goes with its depth more than noise does by chance."""
    assert evidence.force is not None
    depth = np.where(evidence.touching, evidence.places.depth, 0)[..., None] * evidence.normal
    depth, force = (x - x.mean(axis=0) for x in (depth, evidence.force))
    square = np.maximum(np.sum(depth**2, axis=(0, 2)), 1e-300)
    stiffness = np.sum(depth * force, axis=(0, 2)) / square
    left = np.moveaxis(force - stiffness[:, None] * depth, 1, 0)
    errors = [np.mean(x**2) * correlation_time([x[None]]) for x in left]
    return bool(np.any(stiffness**2 * square > _CHANCE**2 * np.array(errors)))
