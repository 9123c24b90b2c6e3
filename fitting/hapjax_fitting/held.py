"""What a recording of one held object says where its poses were not recorded: by its fingers' places among each other.

Where the object is, is not known then. But forces on fingers that hold something convex point away from the other
fingers; the nearer together they are, the more they press; and all together they carry its weight.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from hapjax import Finding, Mesh, Object, Recording, Scene

from .clocks import best_shift, how_shifted
from .evidence import at, closest
from .motion import FEW, Stuck, stuck_by
from .noise import correlation_time, is_quiet, noise_of

_TOWARDS = 0.6  # of a force's size: more than friction makes point towards the other fingers, and
_AWAY = 0.3  # so much points away from them, of what is held
SURE = 2.5  # standard errors of a mass
_LENGTHS = {1e-3: "millimetres", 1e-2: "centimetres", 1e3: "kilometres"}
_FORCES = {1e-3: "millinewtons", 1e3: "kilonewtons"}
_HAND, _OFF = (0.02, 200.0), 50.0  # N that fingers press with; by what factor a mass may be wrong
_APART = (0.02, 1.1)  # how far apart pressing fingers are, over the object's width
_FROM = 100.0  # m
_SMOOTH = 0.05  # s, for accelerations
_FAR, _PART, _LEAST, _SAMPLES = (
    0.3,
    0.5,
    6e-3,
    400,
)  # s; of a recording's length; s; moments that are looked at
_LEAD = 3.0  # times as far ahead as damping may make a force


@dataclass(frozen=True)
class Grip:
    """A recording's N moments with force of F fingers that hold an object.

    `hip` (N, F, 3) m, `force` (N, F, 3) N; `pressed` (N, F), where it is beyond doubt; `noise`, its standard deviation.
    """

    scene: Scene
    recording: Recording
    name: str
    times: np.ndarray
    hip: np.ndarray
    force: np.ndarray
    pressed: np.ndarray
    noise: float

    @property
    def thing(self) -> Object:
        """What is held."""
        return self.scene.object[self.name]

    def away(self, hip: np.ndarray) -> np.ndarray:
        """From the middle of the other pressing fingers to each (..., N, F, 3) m; 0 where there are none."""
        weight = self.pressed[..., None].astype(float)
        count = weight.sum(-2, keepdims=True) - weight
        others = ((hip * weight).sum(-2, keepdims=True) - hip * weight) / np.maximum(count, 1)
        return np.where((count > 0) & (weight > 0), hip - others, 0.0)


def lies_of_grip(scene: Scene, recording: Recording) -> list[Finding]:
    """What is odd about a recording of one held object without poses: units, signs, fingers, clocks, stuck encoders."""
    grip = grip_of(scene, recording)
    if grip is None:
        return _nothing(scene, recording)
    grip, found = _length(grip)
    grip, dealt = _dealt(grip)
    grip, scaled = _force(grip)
    suspects = _stuck(grip)
    late = _late(grip, suspects)
    return found + dealt + scaled + late + ([] if late else [each.finding for each in suspects])


def _nothing(scene: Scene, recording: Recording) -> list[Finding]:
    """No force at all."""
    if recording.force is None:
        return []
    noise = float(noise_of([recording], None, scene.integrator.dt.dtype).force)
    if not is_quiet(recording.force, noise):
        return []
    sentence = f"no force is above its noise, {noise:.2g} N: nothing was touched"
    return [Finding("force", "no contact", sentence)]


def grip_of(scene: Scene, recording: Recording) -> Grip | None:
    """The recording as a grip; None where fingers may touch several things, or one from inside, or do not hold it."""
    names = scene.touchable()
    if (
        recording.hip is None
        or recording.hip_t is None
        or recording.force is None
        or recording.force_t is None
    ):
        return None
    if len(names) != 1 or isinstance(scene.object[names[0]].shape, Mesh) or recording.hip.shape[1] < 2:
        return None
    inside = (recording.force_t >= recording.hip_t[0]) & (recording.force_t <= recording.hip_t[-1])
    times, force = recording.force_t[inside], recording.force[inside]
    if len(times) < FEW:
        return None
    strength = np.linalg.norm(force, axis=-1)
    noise = float(noise_of([recording], None, scene.integrator.dt.dtype).force)
    noise = max(noise, 1e-3 * float(np.sqrt(np.mean(force**2))))
    pressed = strength > max(5 * noise, 0.05 * float(np.quantile(strength, 0.95)))
    pressed &= pressed.sum(axis=1, keepdims=True) > 1
    hip = at(times, recording.hip_t, recording.hip)
    grip = Grip(scene, recording, names[0], times, hip, force, pressed, noise)
    return grip if pressed.sum() >= 2 * FEW else None


def _length(grip: Grip) -> tuple[Grip, list[Finding]]:
    """Fingers farther apart, or closer together, than what they hold is wide."""
    away = grip.away(grip.hip)
    held = np.linalg.norm(away, axis=-1) > 0
    if not held.any():
        return grip, []
    apart = float(np.median(np.linalg.norm(away[held], axis=-1)))
    widest, beside = _widths(
        grip, np.median(away[held] * np.sign(away[held] @ away[held][0])[:, None], axis=0)
    )
    low, high = _APART[0] * widest, _APART[1] * widest
    likely = [factor for factor in _LENGTHS if low <= factor * apart <= high]
    if low <= apart <= high or not likely:
        return grip, []
    factor = min(likely, key=lambda factor: abs(np.log(factor * apart / beside)))
    sentence = (
        f"hip looks like {_LENGTHS[factor]}, expected metres: fingers that press are {apart:.4g} m apart, and "
        f"{grip.name} is {widest:.3g} m wide"
    )
    assert grip.recording.hip is not None
    recording = replace(grip.recording, hip=factor * grip.recording.hip)
    found = [Finding("hip", "length unit", sentence)]
    return replace(grip, recording=recording, hip=factor * grip.hip), found


def _widths(grip: Grip, way: np.ndarray) -> tuple[float, float]:
    """How wide the object is (m), where it is widest as far as 13 directions tell, and along a way as it lies at first."""
    steps = np.array([-1, 0, 1])
    ways = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)[:13].astype(float)
    turn = Rotation.from_quat(np.asarray(grip.thing.orientation, float), scalar_first=True)
    ways = np.concatenate([ways, turn.inv().apply(way)[None]])
    ways /= np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-300)
    # From far away, what is nearest is what lies farthest out.
    points = _FROM * np.concatenate([ways, -ways])
    depth, _ = closest(grip.thing.shape, points, grip.scene.integrator.dt.dtype)
    wide = 2 * _FROM + depth[:14] + depth[14:]
    return float(wide[:13].max()), float(wide[13])


def _dealt(grip: Grip) -> tuple[Grip, list[Finding]]:
    """Forces of the right sign at the right fingers, and what was wrong with them."""
    away = grip.away(grip.hip)
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-300)
    force = grip.force * grip.pressed[..., None]
    size = np.maximum(np.linalg.norm(force, axis=-1).sum(axis=0), 1e-300)
    share = np.einsum("nix,njx->ij", away, force) / size  # of force j along the way out at finger i
    own = np.diag(share)
    wrong = np.flatnonzero(own < -_TOWARDS)
    if not len(wrong):
        return grip, []
    dealt = linear_sum_assignment(-share)[1]
    mends = (dealt != np.arange(len(own))).any() and (share[np.arange(len(own)), dealt] > _AWAY).all()
    mass, error = _carried(grip)
    if mends and not (len(wrong) == len(own) and mass < -SURE * error):
        pairs = ", ".join(f"force {j} to finger {i}" for i, j in enumerate(dealt) if i != j)
        known = len(wrong) < len(own) or mass > SURE * error
        sentence = (
            f"fingers look swapped between hip and force{'' if known else ', or all forces reversed'}: with {pairs}, forces "
            "point away from the other fingers, as of what is held"
        )
        count = int(np.sum(dealt != np.arange(len(own))))
        found = [Finding("force", "swapped fingers", sentence, count=count)]
        return _with_forces(grip, grip.force[:, dealt]), found
    found = []
    for finger in wrong.tolist():
        towards = int(np.sum(np.sum(force[:, finger] * away[:, finger], axis=-1) < 0))
        sentence = (
            f"force of finger {finger} points towards the other fingers in {towards} of "
            f"{grip.pressed[:, finger].sum()} samples in which it holds {grip.name}: its sign looks reversed, as of the "
            "force on the object"
        )
        found.append(Finding("force", "force sign", sentence, count=towards))
    sign = np.ones((grip.force.shape[1], 1))
    sign[wrong] = -1
    return _with_forces(grip, sign * grip.force), found


def _with_forces(grip: Grip, force: np.ndarray) -> Grip:
    return replace(grip, force=force)


def _carried(grip: Grip) -> tuple[float, float]:
    """The mass (kg) that the fingers carry together, and its standard error."""
    return carried(grip.scene, grip.times, grip.hip, grip.force, grip.pressed.sum(axis=1) > 1)


def carried(
    scene: Scene, times: np.ndarray, hip: np.ndarray, force: np.ndarray, held: np.ndarray
) -> tuple[float, float]:
    """The mass (kg) that fingers (N, F, 3) carry and accelerate together, with the hips' accelerations, and its standard
    error; while something is `held` (N,)."""
    hip, dt = hip.mean(axis=1), float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    window = max(int(_SMOOTH / dt) // 2 * 2 + 1, 5)
    if window > len(hip) or np.count_nonzero(held) < FEW:
        return 0.0, np.inf
    gravity = scene.world.gravity
    pull = -np.asarray(savgol_filter(hip, window, 3, deriv=2, delta=dt, axis=0))
    pull = pull + (0 if gravity is None else np.asarray(gravity, float))
    pull, whole = pull[held], force.sum(axis=1)[held]
    square = max(float(np.sum(pull**2)), 1e-300)
    mass = float(np.sum(whole * pull)) / square
    left = whole - mass * pull
    return mass, float(np.sqrt(np.sum(left**2) / (3 * len(left)) * correlation_time([left[None]]) / square))


def _force(grip: Grip) -> tuple[Grip, list[Finding]]:
    """Forces in another unit, by the mass that they carry."""
    typical = float(np.median(np.linalg.norm(grip.force, axis=-1)[grip.pressed]))
    mass, error = _carried(grip)
    assert grip.thing.body is not None
    given = float(grip.thing.body.mass)
    if _HAND[0] <= typical <= _HAND[1] or mass < SURE * error or given / _OFF <= mass <= given * _OFF:
        return grip, []
    for factor, unit in _FORCES.items():
        if given / _OFF <= factor * mass <= given * _OFF:
            sentence = (
                f"force looks like {unit}, expected newtons: it is {typical:.4g} N typically, and carries {mass:.3g} kg of "
                f"{grip.name}, which has {given:.3g} kg"
            )
            return _with_forces(grip, factor * grip.force), [Finding("force", "force unit", sentence)]
    return grip, []


def _squeeze(grip: Grip) -> tuple[np.ndarray, np.ndarray]:
    """Where all fingers press (N,), and with how much force (N,) N along the ways apart, on average."""
    away = grip.away(grip.hip)
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-300)
    return np.asarray(grip.pressed.all(axis=1)), np.sum(grip.force * away, axis=-1).mean(axis=-1)


def _distance(grip: Grip, hip: np.ndarray) -> np.ndarray:
    """How far each finger is from the others, on average (..., N) m."""
    return np.linalg.norm(grip.away(hip), axis=-1).mean(axis=-1)


def _stuck(grip: Grip) -> list[Stuck]:
    """Axes that stay at one number, as a jump at the end tells, or a squeeze that does not follow the distance."""
    return stuck_by(grip.recording, partial(_against, grip))


def _against(grip: Grip, finger: int, axes: tuple[int, ...], begin: float, end: float) -> str | None:
    """What the squeeze says against a rest of a finger's axes."""
    return next(filter(None, (_contradicted(grip, axis, begin, end) for axis in axes)), None)


def _contradicted(grip: Grip, axis: int, begin: float, end: float) -> str | None:
    """A squeeze during a rest that is not the one that the distance gives outside of it."""
    held, force = _squeeze(grip)
    during = held & (grip.times >= begin) & (grip.times <= end)
    beside = held & ~during
    if during.sum() < FEW or beside.sum() < FEW:
        return None
    along = np.abs(grip.away(grip.hip)[during, :, axis]) / np.linalg.norm(
        grip.away(grip.hip)[during], axis=-1
    )
    distance = _distance(grip, grip.hip)
    centre, middle = distance[beside].mean(), force[beside].mean()
    spread = max(float(np.sum((distance[beside] - centre) ** 2)), 1e-300)
    slope = float(np.sum((distance[beside] - centre) * (force[beside] - middle))) / spread
    off = force - middle - slope * (distance - centre)
    wrong, usual, size = (float(np.sqrt(np.mean(x**2))) for x in (off[during], off[beside], force[during]))
    if along.mean() <= 0.5 or wrong <= max(5 * grip.noise, 0.15 * size, 3 * usual):
        return None
    return f"while the fingers squeeze by {wrong:.3g} N more or less than their distance gives ({size:.3g} N)"


def _late(grip: Grip, suspects: Sequence[Stuck]) -> list[Finding]:
    """A force whose clock is shifted against that of the fingers: the squeeze follows their distance at another time."""
    hip, hip_t = grip.recording.hip, grip.recording.hip_t
    assert hip is not None and hip_t is not None
    used, force = _squeeze(grip)
    for each in suspects:
        used &= (grip.times < each.begin) | (grip.times > each.end)
    few = np.flatnonzero(used)[:: -(-int(used.sum()) // _SAMPLES) or 1]
    if len(few) < FEW:
        return []
    times, force, pressed = grip.times[few], force[few], grip.pressed[few]
    thin = replace(grip, pressed=pressed)

    def left_at(lag: float) -> np.ndarray:
        distance = _distance(thin, at(times - lag, hip_t, hip))
        basis = np.stack([distance - distance.mean(), np.ones_like(distance)], axis=-1)
        factors = np.linalg.pinv(basis.T @ basis, hermitian=True) @ basis.T @ force
        if factors[0] > 0:  # as if fingers that come nearer pressed less
            return force - force.mean()
        return force - basis @ factors

    def left(lags: np.ndarray) -> np.ndarray:
        return np.stack([left_at(lag) for lag in lags.tolist()])

    length, noise = float(hip_t[-1] - hip_t[0]), grip.noise / np.sqrt(hip.shape[1])
    now, far = left_at(0.0), min(_FAR, _PART * length)
    lag, cost = best_shift(left, far)
    least = _LEAST + _LEAD * _lead(grip, float(force.mean()))
    how = how_shifted(lag, now, left_at(lag), noise, len(few), far, length) if abs(lag) >= least else None
    if how is None:
        return []
    how = f"about {how}" if how[0].isdigit() else how
    sentence = (
        f"force is {how}: with that undone, only {cost / np.sum(now**2):.1%} of what the distance between fingers does not "
        "explain of their squeeze is left"
    )
    return [Finding("force", "shifted clock", sentence)]


def _lead(grip: Grip, force: float) -> float:
    """By how many s damping makes a force of so many N run ahead of its depth."""
    surface = grip.thing.surface
    assert surface is not None
    return 0.0 if surface.damping is None else float(surface.damping) * force / float(surface.stiffness)
