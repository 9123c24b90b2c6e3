"""Each lie that a user can tell of a recording gets the finding that names it, and no other; the truth gets none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fitting_cases import floor, forces, held_cube
from fitting_lies import STEPS, found, four_fingers, in_hand, late, lifted, on_floor, strokes
from hapjax import Recording, cast
from hapjax_fitting import fit
from hapjax_fitting.benchmark import pushed, speed
from hapjax_fitting.benchmark.cases import CASES
from hapjax_fitting.evidence import scaled
from hapjax_fitting.findings import findings_of
from hapjax_fitting.sensors import Sensors

# What is true ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.2])
@pytest.mark.parametrize(("every", "seed"), [(1, 0), (10, 1)])
def test_a_true_recording_gives_no_finding(seed, every, sigma):
    """Whatever stiffness and friction the scene begins with."""
    for scene in (floor(), floor(mu=0.06, stiffness=8000.0), floor(mu=3.0, stiffness=80.0)):
        assert found(on_floor(seed, sigma, every=every), scene, friction=True) == (set(), "")


@pytest.mark.parametrize("seed", range(3))
def test_a_true_grasp_gives_no_finding(seed):
    for scene in (held_cube(), held_cube(mass=2.0, stiffness=100.0)):
        assert found(in_hand(seed), scene) == (set(), "")


def test_a_path_that_is_made_to_rest_along_an_axis_gives_no_finding():
    t, path, _ = strokes()
    path = path.copy()
    path[100:, :, 2] = path[100, :, 2]
    force = forces(floor(), path) + 0.02 * np.random.default_rng(4).standard_normal(path.shape)
    assert found(Recording(hip=path, hip_t=t, force=force, force_t=t), friction=True) == (set(), "")


@pytest.mark.parametrize(("step", "fades"), [(1e-4, 1.0), (1e-4, 0.6), (1e-9, 0.6)])
def test_a_hand_that_rests_gives_no_finding(step, fades):
    """Its force changes within one step of the encoder, or as what is pressed on yields."""
    t, random = 1e-3 * np.arange(1000), np.random.default_rng(5)
    depth = np.interp(t, [0, 0.1, 0.9, 1], [-5e-4, 3.2e-4, 3.2e-4, -5e-4])
    depth += 3e-5 * np.sin(40 * t) * np.clip(step / 1e-4, 0, 1)
    path = np.stack([0 * t, 0 * t, -depth], axis=-1)[:, None]
    force = forces(floor(stiffness=1e4), path) * np.interp(t, [0.1, 0.9], [1, fades])[:, None, None]
    force += 0.02 * random.standard_normal(force.shape)
    pressed = Recording(hip=step * np.round(path / step), hip_t=t, force=force, force_t=t)
    assert found(pressed, floor(stiffness=2e3)) == (set(), "")


@pytest.mark.parametrize("seed", range(2))
def test_motions_that_come_again_look_the_same_at_other_times_but_no_better(seed):
    """Strokes at one rate, and an object that swings: noise alone is told apart from a clock that is shifted."""
    recording, case = speed.strokes(20, seed), CASES["critical area"]
    assert found(recording, speed.floor(*speed.TRUTH), friction=True) == (set(), "")
    assert ("shifted clock", "pose") not in found(case.recorded(seed), case.truth())[0]


@pytest.mark.parametrize("sigma", [1.0, 2.0])
def test_a_force_is_told_from_its_noise_where_no_sample_of_it_is_above(sigma):
    """And is missed, whatever an unplugged sensor always shows."""
    grasp, bare = lifted(), replace(lifted(), pose=None, pose_t=None)
    for recording, force, scene, kind in (
        (on_floor(), strokes()[2], floor(), "no force"),
        (grasp, grasp.force, held_cube(), "no force"),
        (bare, grasp.force, held_cube(), "no contact"),
    ):
        assert force is not None
        noise = sigma * np.random.default_rng(2).standard_normal(force.shape)
        assert found(replace(recording, force=force + noise), scene) == (set(), "")
        assert found(replace(recording, force=0.8 * sigma + noise), scene)[0] == {(kind, "force")}


@pytest.mark.parametrize("count", [1, 3, 10])
def test_a_few_forces_give_no_finding(count):
    for r, scene in ((on_floor(), floor()), (replace(in_hand(), pose=None, pose_t=None), held_cube())):
        few = {key: getattr(r, key)[200::5][:count] for key in ("force", "force_t")}
        assert found(replace(r, **few), scene) == (set(), "")


def test_positions_alone_give_no_finding():
    bare = replace(on_floor(), force=None, force_t=None)
    assert found(replace(bare, pose=in_hand().pose, pose_t=in_hand().pose_t), floor(), friction=True) == (
        set(),
        "",
    )


# What is not ----------------------------------------------------------------------------------------------


def frozen(recording, axis, jitter=0.0):
    hip = recording.hip.copy()
    third = len(hip) // 3
    hip[third : 2 * third, 0, axis] = hip[third, 0, axis] + jitter * np.random.default_rng(0).normal(
        size=third
    )
    return replace(recording, hip=hip)


def dead(recording, axis):
    """From the beginning to the end."""
    hip = recording.hip.copy()
    hip[:, 0, axis] = hip[len(hip) // 2, 0, axis]
    return replace(recording, hip=hip)


def asleep(recording, until=2 / 3, fingers=(0,)):
    """All axes of fingers, from a third on."""
    hip = recording.hip.copy()
    third = len(hip) // 3
    hip[third : int(until * len(hip)), fingers] = hip[third, fingers]
    return replace(recording, hip=hip)


def exchanged(recording):
    """A sensor that is mounted a quarter turn off."""
    x, y, z = np.moveaxis(recording.force, -1, 0)
    return replace(recording, force=np.stack([y, -x, z], axis=-1))


def silent(recording):
    noise = 0.02 * np.random.default_rng(9).standard_normal(recording.force.shape)
    return replace(recording, force=noise)


def one_reversed(recording):
    return replace(recording, force=recording.force * [[[1.0], [-1.0]]])


# The lie; what is found: kind and channel; a part of the words.
LIES = {
    "force on the object": (
        lambda r: replace(r, force=-r.force),
        ("force sign", "force"),
        "points into the surface in 100%",
    ),
    "one sensor reversed": (one_reversed, ("force sign", "force"), "force of finger 1"),
    "millimetres": (lambda r: scaled(r, hip=1e3, pose=1e3), ("length unit", "hip"), "millimetres"),
    "fingers in millimetres": (
        lambda r: scaled(r, hip=1e3),
        ("length unit", "hip"),
        "hip looks like millimetres",
    ),
    "millinewtons": (lambda r: scaled(r, force=1e3), ("force unit", "force"), "millinewtons"),
    "kilonewtons": (lambda r: scaled(r, force=1e-3), ("force unit", "force"), "kilonewtons"),
    "late force": (lambda r: replace(r, force_t=r.force_t + 0.02), ("shifted clock", "force"), "force is"),
    "early force": (lambda r: replace(r, force_t=r.force_t - 0.03), ("shifted clock", "force"), "force is"),
    "force by a clock that is fast": (
        lambda r: replace(r, force_t=1.03 * r.force_t),
        ("clock rate", "force"),
        "% fast against the others",
    ),
    "swapped fingers": (
        lambda r: replace(r, force=r.force[:, ::-1]),
        ("swapped fingers", "force"),
        "force 1 to finger 0",
    ),
    "beside the scene": (
        lambda r: replace(r, hip=r.hip + [0, 0, 0.2]),
        ("no contact", "hip"),
        "no finger touches",
    ),
    "force unplugged": (silent, ("no force", "force"), "above its noise"),
    "finger stuck for a while": (asleep, ("stuck encoder", "hip"), "all of finger 0 stays at"),
    "force in milliseconds": (
        lambda r: replace(r, force_t=1e3 * r.force_t),
        ("time unit", "force"),
        "look like milliseconds",
    ),
    "x stuck for a while": (lambda r: frozen(r, 0), ("stuck encoder", "hip"), "x of finger 0 stays"),
    "x stuck but for jitter": (lambda r: frozen(r, 0, 1e-6), ("stuck encoder", "hip"), "x of finger 0 stays"),
}
FLOOR_LIES = {
    "x of force reversed": (
        lambda r: replace(r, force=r.force * [-1.0, 1.0, 1.0]),
        ("force sign", "force"),
        "x of the force of finger 1 points",
    ),
    "z of one force reversed": (
        lambda r: replace(r, force=r.force * [[[1.0, 1.0, -1.0], [1.0] * 3]]),
        ("force sign", "force"),
        "so read, x of the force of finger 0 points",
    ),
    "force a quarter turn off": (exchanged, ("force axes", "force"), "its -y, x, z read as the world's"),
    "finger stuck to the end": (lambda r: asleep(r, 1.0), ("stuck encoder", "hip"), "its force changes by"),
    "fingers stuck to the end": (
        lambda r: asleep(r, 1.0, (0, 1)),
        ("stuck encoder", "hip"),
        "all of finger 1 stays",
    ),
    "z stuck for a while": (lambda r: frozen(r, 2), ("stuck encoder", "hip"), "z of finger 0 stays"),
    "z stuck but for jitter": (lambda r: frozen(r, 2, 1e-6), ("stuck encoder", "hip"), "z of finger 0 stays"),
    "force late by more than half": (
        lambda r: replace(r, force_t=r.force_t + 0.3),
        ("shifted clock", "force"),
        "ms late",
    ),
    "x never moves": (lambda r: dead(r, 0), ("stuck encoder", "hip"), "friction pulls along it"),
    "z never moves": (lambda r: dead(r, 2), ("stuck encoder", "hip"), "from what its depth gives"),
    "gimbal in degrees": (
        lambda r: replace(r, gimbal=90 * np.sin(9 * r.hip[..., 0] / 0.02), gimbal_t=r.hip_t),
        ("angle unit", "gimbal"),
        "degrees",
    ),
}
CUBE_LIES = {
    "centimetres": (lambda r: scaled(r, hip=1e2, pose=1e2), ("length unit", "hip"), "centimetres"),
    "poses in millimetres": (
        lambda r: scaled(r, pose=1e3),
        ("length unit", "pose"),
        "pose looks like millimetres",
    ),
    "poses by a clock that is slow": (
        lambda r: replace(r, pose_t=0.98 * r.pose_t),
        ("clock rate", "pose"),
        "% slow",
    ),
    "z of one force reversed, along which it holds": (
        lambda r: replace(r, force=r.force * [[[1.0, 1.0, -1.0], [1.0] * 3]]),
        ("force sign", "force"),
        "z of the force of finger 0 points",
    ),
    "late poses": (lambda r: replace(r, pose_t=r.pose_t + 0.03), ("shifted clock", "pose"), "pose is"),
    "late fingers": (lambda r: replace(r, hip_t=r.hip_t + 0.03), ("shifted clock", "hip"), "hip is"),
}


@pytest.mark.parametrize(("sigma", "seed"), [(0.0, 0), (0.02, 1), (0.1, 2)])
@pytest.mark.parametrize("lie", LIES | FLOOR_LIES)
def test_each_lie_on_a_floor_is_named(lie, sigma, seed):
    tell, kind, words = (LIES | FLOOR_LIES)[lie]
    for scene in (floor(), floor(mu=0.2, stiffness=250.0)):
        kinds, said = found(tell(on_floor(seed, sigma)), scene, friction=True)
        assert kinds == {kind}, said
        assert words in said, said


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("lie", LIES | CUBE_LIES)
def test_each_lie_of_a_grasp_is_named(lie, seed):
    tell, kind, words = (LIES | CUBE_LIES)[lie]
    kinds, said = found(tell(in_hand(seed)))
    assert kinds == {kind}, said
    assert words in said, said


@pytest.mark.parametrize(("axis", "surface"), [(1, {"mu": 0.1}), (0, {"mu": 0.05, "damping": 5.0})])
def test_an_axis_is_named_along_which_little_is_felt(axis, surface):
    """Where friction is small beside what damps the normal force, or small along that axis."""
    t, path, _ = strokes()
    path = path + 0.3 * (path[..., :1] - path[0, :, :1]) * [0.0, 1.0, 0.0]
    force = forces(floor(**surface), path) + 0.01 * np.random.default_rng(0).standard_normal(path.shape)
    recording = Recording(hip=path, hip_t=t, force=force, force_t=t)
    assert found(recording, floor()) == (set(), "")
    kinds, said = found(replace(recording, force=force * np.where(np.arange(3) == axis, -1.0, 1.0)), floor())
    assert kinds == {("force sign", "force")}
    assert f"{'xy'[axis]} of the force of finger 0 points" in said, said


def pushed_block(mu=0.5):
    return cast(pushed.scene(mu, 0.2), np.float64)


# Of a grasp of which no poses were recorded: the lie, what is found, a part of the words.
BARE_LIES = {
    name: LIES[name]
    for name in (
        "fingers in millimetres",
        "millinewtons",
        "kilonewtons",
        "finger stuck for a while",
        "x stuck for a while",
        "x stuck but for jitter",
    )
} | {
    "one sensor reversed": (
        LIES["one sensor reversed"][0],
        ("force sign", "force"),
        "force of finger 1 points",
    ),
    "force on the object": (LIES["force on the object"][0], ("force sign", "force"), "towards the other"),
    "fingers in centimetres": (lambda r: scaled(r, hip=1e2), ("length unit", "hip"), "centimetres"),
    "force unplugged": (silent, ("no contact", "force"), "above its noise"),
    "late force": (lambda r: late(r, 0.05), ("shifted clock", "force"), "force is about 46"),
    "early force": (lambda r: late(r, -0.06), ("shifted clock", "force"), "force is"),
    "swapped fingers": (LIES["swapped fingers"][0], ("swapped fingers", "force"), "point away"),
}


@pytest.mark.parametrize("lie", [None, *BARE_LIES])
def test_each_lie_of_a_grasp_without_poses_is_named(lie):
    """By the fingers alone: they are held apart by what is between them, and carry its weight."""
    tell, kind, words = BARE_LIES.get(lie, (lambda r: r, None, ""))
    scene, shaken = four_fingers()
    cases = [(held_cube(), in_hand()), (held_cube(mass=1.0, stiffness=250.0), in_hand(1))]
    if "sensor" not in str(lie) and "clock" not in str(kind):
        cases.append((scene, shaken))
    for given, recording in cases:
        kinds, said = found(tell(replace(recording, pose=None, pose_t=None)), given)
        assert kinds == ({kind} if kind else set()), said
        assert words in said, said


# Of a block that one finger pushes along x: the lie, what is found, a part of the words.
PUSHED_LIES = {
    "fingers in millimetres": LIES["fingers in millimetres"],
    "millimetres": LIES["millimetres"],
    "x stuck for a while": LIES["x stuck for a while"],
    "x stuck but for jitter": LIES["x stuck but for jitter"],
    "late force": LIES["late force"],
    "x never moves": (lambda r: dead(r, 0), ("stuck encoder", "hip"), "x of finger 0 stays"),
}


@pytest.mark.parametrize("lie", PUSHED_LIES)
def test_each_lie_of_a_pushed_block_is_named(lie):
    tell, kind, words = PUSHED_LIES[lie]
    kinds, said = found(tell(pushed.recorded(0)), pushed_block(), friction=True)
    assert kinds == {kind}, said
    assert words in said, said


def test_a_true_push_gives_no_finding():
    for seed in range(3):
        assert found(pushed.recorded(seed), pushed_block(0.2), friction=True) == (set(), "")


@pytest.mark.parametrize("seed", range(2))
def test_noise_that_wanders_is_no_stuck_encoder(seed):
    """A stroke along x alone, so that y rests."""
    t, path, clean = strokes()
    random, wander = np.random.default_rng(seed), np.zeros_like(clean)
    for i in range(1, len(clean)):
        wander[i] = 0.95 * wander[i - 1] + 0.1 * np.sqrt(1 - 0.95**2) * random.standard_normal(clean[i].shape)
    assert found(Recording(hip=path, hip_t=t, force=clean + wander, force_t=t), friction=True) == (set(), "")


@pytest.mark.parametrize("jitter", [0.0, 1e-6])
def test_a_finger_that_is_stuck_outside_may_as_well_not_touch(jitter):
    t, path, clean = strokes()
    hip = path[:, :1].copy()
    hip[:, 0, 2] = 1e-3 + jitter * np.random.default_rng(0).standard_normal(STEPS)
    one = Recording(hip=hip, hip_t=t, force=clean[:, :1], force_t=t)
    kinds, said = found(one, friction=True)
    assert kinds == {("no contact", "hip"), ("stuck encoder", "hip")}
    assert "z of finger 0 stays at 0.001" in said


def test_what_is_known_of_the_sensors_is_not_odd():
    """A force sensor that is late and shows too much, and a frame that is turned: each alone is odd."""
    bias = [0.4, 0.0, -0.8]
    true, sensors = on_floor(), Sensors(force_delay=0.02, force_bias=bias, hip_rotation=[0.01, 0.0, 0.0])
    turn = Rotation.from_rotvec([-0.01, 0.0, 0.0])
    hip = turn.apply(strokes()[1].reshape(-1, 3)).reshape(STEPS, 2, 3)
    measured = replace(late(true, 0.02), hip=hip, force=strokes()[2] + bias)
    scene = cast(floor(), np.float64)
    assert findings_of(scene, [measured], ["a"])
    assert findings_of(scene, [late(true, 0.02)], ["a"])
    assert findings_of(scene, [measured], ["a"], sensors={"a": sensors}) == ()


@pytest.mark.parametrize("sigma", [0.0, 0.02])
def test_what_never_slips_is_named(sigma):
    """Where a mu is wanted; the strokes that slide are not, though the scene's mu would hold them."""
    short = on_floor(0, sigma, length=5e-4)
    assert found(short, friction=True)[0] == {("no slip", "force")}
    assert found(short, friction=False)[0] == set()
    assert found(on_floor(0, sigma), floor(mu=30.0), friction=True)[0] == set()
    assert found(in_hand(), friction=True)[0] == {("no slip", "force")}


@pytest.mark.parametrize(("length", "slides"), [(1.0e-3, False), (1.35e-3, True)])
def test_a_fit_that_finds_mu_in_a_slip_too_small_to_be_seen_does_not_say_that_none_can_be(length, slides):
    free = ("object.floor.surface.mu", "object.floor.surface.stiffness")
    short = on_floor(0, length=length)
    assert found(short, friction=True)[0] == {("no slip", "force")}
    result = fit(floor(), [short], free, starts=1)
    assert result.parameters[free[0]].identified == slides
    assert [finding.kind for finding in result.findings] == ([] if slides else ["no slip"])


def test_several_recordings_are_told_apart():
    recordings = [on_floor(), LIES["force on the object"][0](on_floor(1))]
    every = findings_of(cast(floor(), np.float64), recordings, ["a.npz", "b.npz"])
    assert {finding.recording for finding in every} == {"b.npz"}
    assert str(every[0]).startswith("b.npz: force sign: ")
