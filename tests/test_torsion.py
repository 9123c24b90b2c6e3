"""Torsion models: gimbals that turn an object about the grasp's line, and fingertips with an area."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.torsion import Grip
from helpers import G, at_rest, matrix, moving

K, MU, MASS, EDGE, DEPTH = 800.0, 0.9, 0.1, 0.06, 3e-3
INERTIA = (1.1e-4, 1.0e-4, 0.9e-4)
AREA = np.pi * (MU * DEPTH) ** 2
PINCH = np.array([[EDGE / 2 - DEPTH, 0, 0], [DEPTH - EDGE / 2, 0, 0]])


def held(torsion=None, gravity=None, surface=None, **integrator):
    surface = hapjax.Surface(K, mu=MU, damping=1.0) if surface is None else surface
    box = hapjax.Object(hapjax.Box((EDGE,) * 3), surface, hapjax.Body(MASS, INERTIA))
    world = hapjax.World(gravity=gravity)
    return hapjax.Scene(
        {"it": box}, torsion=torsion, world=world, integrator=hapjax.SemiImplicit(**integrator)
    )


def play(scene, hips, gimbals=None, dtype=np.float64, **start):
    scene, hips = hapjax.cast(scene, dtype), jnp.asarray(hips, dtype)
    first = None if gimbals is None else gimbals[0]
    state = moving(hapjax.init(scene, hips[0], first), "it", **start)
    return jax.tree.map(np.asarray, hapjax.rollout(scene, state, hips, gimbals=gimbals))


def tilts(replies):
    """The turn about the x axis, rad, unwrapped."""
    up = np.array([matrix(q)[:, 2] for q in replies.pose[:, 0, 3:]])
    return np.unwrap(np.arctan2(-up[:, 1], up[:, 2]))


# Gimbals --------------------------------------------------------------------------------------------------

STEPS = 200
ANGLES = np.stack([0.9 * np.sin(np.linspace(0, 5, STEPS)), np.linspace(0, 0.5, STEPS)], axis=1)


@pytest.mark.parametrize("substeps", [1, 3])
def test_gimbals_turn_a_firmly_held_object_by_their_mean(substeps, dtype):
    torsion = hapjax.Gimbal(0.5 * AREA)
    angles = ANGLES.astype(dtype)
    state, replies = play(held(torsion, substeps=substeps), at_rest(PINCH, STEPS), angles, dtype)
    # From the first finger, at +x, to the second: right-handed about -x.
    expected = -(ANGLES - ANGLES[0]).mean(axis=1)
    assert np.ptp(expected) > 0.4
    assert tilts(replies) == pytest.approx(expected, abs=2e-5 if dtype == jnp.float32 else 1e-9)
    assert state.gimbal == pytest.approx(angles[-1]) and state.gimbal.dtype == dtype


def test_the_line_goes_from_the_earlier_finger_to_the_later():
    torsion = hapjax.Gimbal(0.5 * AREA)
    fingers = np.vstack([PINCH[1], [[9.0, 9.0, 9.0]], PINCH[0]])  # the one in the middle touches nothing
    angles = np.insert(ANGLES, 1, 7 * np.sin(np.arange(STEPS)), axis=1)
    _, replies = play(held(torsion), at_rest(fingers, STEPS), angles)
    assert tilts(replies) == pytest.approx((ANGLES - ANGLES[0]).mean(axis=1), abs=1e-9)


@pytest.mark.parametrize("share", [0.4, 1.6])
def test_with_gimbals_at_rest_it_is_the_gravity_drop(share):
    ends = []
    for model in (hapjax.Gimbal, hapjax.GravityDrop):
        scene = held(model(AREA / share, twist_damping=1e-4), gravity=(0, 0, -G))
        gimbals = np.full((100, 2), 0.3) if model is hapjax.Gimbal else None
        hips = at_rest(PINCH + np.array([0, 0.01, 0.01]), 100)
        ends.append(play(scene, hips, gimbals, spin=(2.0, 0, 0))[1])
    assert np.ptp(tilts(ends[0])) > 0.05 or share > 1
    assert ends[0].pose == pytest.approx(ends[1].pose, abs=1e-13)
    assert ends[0].force == pytest.approx(ends[1].force, abs=1e-10)


def test_a_light_grip_leaves_the_object_where_the_gimbals_go():
    _, replies = play(held(hapjax.Gimbal(1e3 * AREA)), at_rest(PINCH, STEPS), ANGLES)
    assert np.abs(tilts(replies)).max() < 1e-6
    # The damping is of the spin against the gimbals': it drags the object along.
    damped = hapjax.Gimbal(1e3 * AREA, twist_damping=1e-2)
    _, replies = play(held(damped), at_rest(PINCH, STEPS), ANGLES)
    rate, turned = 0.0, []
    for step in -np.diff(ANGLES.mean(axis=1), prepend=0):
        rate += 1e-3 * (1e-2 / INERTIA[0]) * (step / 1e-3 - rate)
        turned.append(1e-3 * rate)
    assert tilts(replies) == pytest.approx(np.cumsum(turned), abs=2e-3)


@pytest.mark.parametrize(
    ("torsion", "gimbal", "words"),
    [
        (hapjax.Gimbal(1e-5), None, ["gimbal is missing", "rad"]),
        (hapjax.Gimbal(1e-5), np.zeros(3), ["gimbal", "(3,)", "(2,)"]),
        (hapjax.GravityDrop(1e-5), np.zeros(2), ["gimbal is given"]),
        (None, np.zeros(2), ["gimbal is given"]),
    ],
)
def test_gimbals_are_given_exactly_where_they_are_read(torsion, gimbal, words):
    scene = held(torsion)
    with pytest.raises(hapjax.InputError) as refused:
        hapjax.init(scene, PINCH, gimbal)
    assert all(word in str(refused.value) for word in words)
    good = np.zeros(2) if isinstance(torsion, hapjax.Gimbal) else None
    state = hapjax.init(scene, PINCH, good)
    with pytest.raises(hapjax.InputError) as refused:
        hapjax.step(scene, state, PINCH, gimbal=gimbal)
    assert all(word in str(refused.value) for word in words)


def test_a_path_of_gimbals_as_long_as_that_of_the_fingers():
    scene = held(hapjax.Gimbal(1e-5))
    state = hapjax.init(scene, PINCH, np.zeros(2))
    with pytest.raises(hapjax.InputError, match=r"gimbals has the shape \(5, 2\).*\(6, 2\)"):
        hapjax.rollout(scene, state, at_rest(PINCH, 6), gimbals=np.zeros((5, 2)))


def test_a_packed_step_takes_gimbals(dtype):
    scene, angles = hapjax.cast(held(hapjax.Gimbal(0.5 * AREA)), dtype), ANGLES.astype(dtype)
    packed = hapjax.pack(scene, PINCH, gimbal=angles[0])
    memory, hip = packed.start, PINCH.astype(dtype)
    for angle in angles[:20]:
        memory = packed.call(memory, hip, angle)
    final, _ = play(scene, at_rest(PINCH, 20), angles[:20], dtype)
    assert packed.state(memory).motion["it"].orientation == pytest.approx(
        final.motion["it"].orientation, abs=1e-6
    )


# Gravity drop ---------------------------------------------------------------------------------------------


def test_the_area_of_the_circles_is_that_of_the_static_mu():
    """A box that spins about the grasp's line is stopped by an area just above A_crit, and not by one just below."""
    surface = hapjax.Surface(K, mu_static=MU, mu_kinetic=0.5 * MU, damping=1.0)
    turned = []
    for share in (1.01, 0.99):
        scene = held(hapjax.GravityDrop(AREA / share), surface=surface)
        turned.append(np.ptp(tilts(play(scene, at_rest(PINCH, 50), spin=(0.5, 0, 0))[1])))
    assert turned == pytest.approx([0, 49 * 1e-3 * 0.5], abs=1e-6)


# Soft fingers ---------------------------------------------------------------------------------------------

TWIST, LIMIT = 0.05, 2e-3  # N m/rad, m


def test_a_finger_resists_turning_as_a_spring_up_to_its_limit(dtype):
    """One turn to and fro in a fixed grip, against the loop of a spring in series with dry friction."""
    model = hapjax.SoftFinger(np.asarray(LIMIT, dtype), np.asarray(TWIST, dtype))
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0]], dtype)
    force = np.array([2.0, 1.0], dtype)
    zero = np.zeros((2, 3), dtype)
    both = np.array([True, True])
    grip = Grip(*map(jnp.asarray, (zero, normals, force, force, both, both)))
    dt = jnp.asarray(1e-3, dtype)
    turned = 0.3 * np.sin(np.linspace(0, 2 * np.pi, 400))
    hold = jax.jit(lambda angle, spin: model.hold(grip, angle, jnp.zeros_like(spin), spin, None, dt))

    angle, found = jnp.zeros(2, dtype), []
    for step in np.diff(turned):
        answer = hold(angle, jnp.asarray([0.5, -0.2, step / 1e-3], dtype))
        angle = answer.angle
        found.append(np.asarray(answer.torque))
    found = np.array(found)
    assert found.dtype == dtype and found[:, :2] == pytest.approx(0, abs=1e-9)
    expected = 0.0
    for limit in LIMIT * force.astype(float):  # each finger on its own: the play operator
        stretch, torque = 0.0, []
        for step in np.diff(turned):
            stretch = np.clip(stretch + step, -limit / TWIST, limit / TWIST)
            torque.append(-TWIST * stretch)
        expected = expected + np.array(torque)
    assert found[:, 2] == pytest.approx(expected, abs=1e-6)
    assert np.abs(expected).max() == pytest.approx(LIMIT * 3)


def test_one_soft_finger_swings_a_box_as_a_torsion_spring():
    """A finger pressed on top of a box that stands on nothing: it twists at sqrt(k / J) about the normal."""
    normal_force = K * DEPTH
    scene = held(hapjax.SoftFinger(LIMIT, TWIST), gravity=(0, 0, normal_force / MASS))  # balances the finger
    hips = at_rest(np.array([[0, 0, EDGE / 2 - DEPTH]]), 300)
    rate = np.sqrt(TWIST / INERTIA[2])
    start = 0.5 * LIMIT * normal_force / TWIST * rate  # half of what would slip
    _, replies = play(scene, hips, spin=(0, 0, start))
    turn = 2 * np.arctan2(replies.pose[:, 0, 6], replies.pose[:, 0, 3])
    time = 1e-3 * np.arange(1, 301)
    assert turn == pytest.approx(start / rate * np.sin(rate * time), abs=0.02 * start / rate)


def test_two_soft_fingers_hold_a_box_beside_its_centre_up_to_their_limit():
    """The weight's moment about the line is m g e; the limit is mu_t times both normal forces."""
    offset = 0.004
    hips = at_rest(PINCH + np.array([0, offset, 0]), 1500)
    needed = MASS * G * offset / (2 * K * DEPTH)
    ends = {}
    for factor in (0.8, 1.25):
        torsion = hapjax.SoftFinger(factor * needed, 0.1, twist_damping=1e-3)
        _, replies = play(held(torsion, gravity=(0, 0, -G)), hips)
        ends[factor] = tilts(replies)
    assert np.ptp(ends[1.25][-300:]) < 1e-4 and abs(ends[1.25][-1]) < 0.1
    assert abs(ends[0.8]).max() > 1


def test_god_angles_are_remembered_only_under_soft_fingers():
    for torsion in (None, hapjax.GravityDrop(1e-5), hapjax.Gimbal(1e-5)):
        gimbal = np.zeros(2) if isinstance(torsion, hapjax.Gimbal) else None
        assert not hapjax.init(held(torsion), PINCH, gimbal).god_angle
    state = hapjax.init(held(hapjax.SoftFinger(1e-3, 0.1)), PINCH)
    assert state.god_angle["it"].shape == (2,) and state.gimbal is None


def test_a_finger_that_lets_go_forgets_its_twist():
    scene = held(hapjax.SoftFinger(LIMIT, TWIST))
    hips = np.concatenate([at_rest(PINCH, 20), at_rest(PINCH * np.array([[1.0], [1.5]]), 1)])
    state, _ = play(scene, hips[:20], spin=(0.5, 0, 0))
    assert np.abs(state.god_angle["it"]).min() > 1e-3
    state, _ = play(scene, hips, spin=(0.5, 0, 0))
    assert state.god_angle["it"][1] == 0 and state.god_angle["it"][0] != 0


# Files and gradients --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "torsion",
    [hapjax.Gimbal(2e-5, twist_damping=1e-4), hapjax.SoftFinger(2e-3, 0.1, 1e-4), hapjax.SoftFinger(0.0, 1)],
)
def test_scene_files_name_every_model(torsion, tmp_path):
    hapjax.save_scene(held(torsion), tmp_path / "scene.toml")
    found = hapjax.load_scene(tmp_path / "scene.toml").torsion
    assert type(found) is type(torsion)
    assert jax.tree.leaves(found) == jax.tree.leaves(torsion)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (dict(torsional_mu=-1e-3, stiffness=0.1), ["torsional_mu", "0 m or above"]),
        (dict(torsional_mu=1e-3, stiffness=0.0), ["stiffness", "above 0 N m/rad"]),
        (dict(torsional_mu=1e-3, stiffness=0.1, twist_damping=-1), ["twist_damping", "N m s/rad"]),
    ],
)
def test_impossible_soft_fingers_are_refused(fields, words):
    with pytest.raises(hapjax.InputError) as refused:
        hapjax.SoftFinger(**fields)
    assert all(word in str(refused.value) for word in words)


@pytest.mark.slow
@pytest.mark.parametrize(
    "torsion",
    [
        hapjax.Gimbal(2.5 * AREA, twist_damping=2e-4),
        hapjax.SoftFinger(1e-2, 0.05, twist_damping=1e-4),  # sticks
        hapjax.SoftFinger(4e-4, 0.05),  # slips
    ],
    ids=["gimbal", "sticking", "slipping"],
)
def test_gradients_of_torsion_agree(torsion):
    """Forward, reverse and central differences of what a torsion's numbers do to a grasp."""
    scene = held(torsion, gravity=(0, 0, -G))
    hips = at_rest(PINCH + np.array([0, 0.004, 0]), 60)
    gimbals = jnp.asarray(ANGLES[:60]) if isinstance(torsion, hapjax.Gimbal) else None
    leaves, tree = jax.tree.flatten(torsion)

    @jax.jit
    def outcome(values):
        numbers = [x * values[i] for i, x in enumerate(leaves)]
        now = hapjax.Scene(scene.object, torsion=jax.tree.unflatten(tree, numbers), world=scene.world)
        first = None if gimbals is None else gimbals[0]
        _, reply = hapjax.rollout(now, hapjax.init(now, hips[0], first), hips, gimbals=gimbals)
        return jnp.stack(
            [jnp.sum(reply.pose[-1, 0, 3:] * jnp.arange(1.0, 5.0)), jnp.sum(reply.force[-1] ** 2)]
        )

    at = jnp.ones(len(leaves))
    forward, reverse = jax.jacfwd(outcome)(at), jax.jacrev(outcome)(at)
    assert np.asarray(forward) == pytest.approx(np.asarray(reverse), rel=1e-9, abs=1e-12)
    eps = 1e-6
    numeric = np.stack(
        [(outcome(at + d) - outcome(at - d)) / (2 * eps) for d in eps * np.eye(len(leaves))], axis=1
    )
    assert numeric == pytest.approx(np.asarray(forward), rel=1e-4, abs=1e-7)
    assert np.abs(forward).max(axis=0).min() > 0 or isinstance(torsion, hapjax.SoftFinger)


def test_simulate_and_fit_feed_the_gimbals(tmp_path):
    """What `hapjax simulate` answers under turning gimbals is what the fit predicts, from the file alone."""
    from hapjax.cli import main
    from hapjax_fitting.observation import observation_of, predicted

    scene = held(hapjax.Gimbal(0.5 * AREA))
    hapjax.save_scene(scene, tmp_path / "scene.toml")
    times = 1e-3 * np.arange(STEPS)
    clock = times[::4]  # a clock of its own
    path = np.asarray(at_rest(PINCH, STEPS))
    file = tmp_path / "hip.npz"
    hapjax.Recording(hip=path, hip_t=times, gimbal=ANGLES[::4], gimbal_t=clock).save(file)
    arguments = [
        "simulate",
        str(tmp_path / "scene.toml"),
        "--hip",
        str(file),
        "--out",
        str(tmp_path / "out.npz"),
    ]
    assert main(arguments) == 0
    answer = hapjax.Recording.load(tmp_path / "out.npz")
    between = np.stack([np.interp(times, clock, a) for a in ANGLES[::4].T], axis=1)
    assert answer.gimbal == pytest.approx(between, abs=1e-12) and answer.pose is not None
    _, replies = play(scene, path, between)
    assert answer.pose == pytest.approx(replies.pose, abs=1e-9)
    said = predicted(scene, observation_of(scene, answer, ("pose",), "answer"))
    assert np.asarray(said["pose"])[:, :, :3] == pytest.approx(
        answer.pose[: len(said["pose"]), :, :3], abs=1e-9
    )
    hapjax.Recording(hip=path, hip_t=times).save(file)
    assert main(arguments) == 2


def test_without_recorded_gimbals_nothing_is_fitted():
    from hapjax_fitting.observation import observation_of

    recording = hapjax.Recording(
        hip=np.asarray(at_rest(PINCH, 5)),
        hip_t=np.arange(5) * 1e-3,
        force=np.zeros((5, 2, 3)),
        force_t=np.arange(5) * 1e-3,
    )
    with pytest.raises(hapjax.InputError, match="lift.npz: gimbal was not recorded"):
        observation_of(held(hapjax.Gimbal(1e-5)), recording, ("force",), "lift.npz")


@pytest.mark.slow
def test_devices_with_gimbals_turn_the_object():
    from hapjax_devices import VirtualDevice, run

    scene = held(hapjax.Gimbal(0.2 * AREA))
    devices = [VirtualDevice(place[None], gimbal=angle) for place, angle in zip(PINCH, ANGLES.T, strict=True)]
    recording = run(scene, devices, STEPS * 1e-3, realtime=False).recording
    late = np.concatenate([ANGLES[:1], ANGLES[:-1]])  # a device's readings are one sample late
    assert recording.gimbal == pytest.approx(late, abs=1e-12)
    assert recording.gimbal_t == pytest.approx(recording.hip_t, abs=0)

    class Plain:
        """A device without a gimbal."""

        force_limit, resolution = 2.0, 3e-5

        def open(self): ...

        def read(self):
            return PINCH[0]

        def write(self, force):
            return force

        def close(self): ...

        def __enter__(self):
            return self

        def __exit__(self, *exception): ...

    with pytest.raises(hapjax.InputError, match="torsion is a gimbal"):
        run(scene, [devices[0], Plain()], 0.01, realtime=False)
