"""Starts: how an object moved when a recording began is found, for each recording by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapjax import Body, InputError, Object, Plane, Recording, Scene, Sphere, World, cli, save_scene
from hapjax_fitting import fit
from hapjax_fitting.start import Start, begun, starts_of

G, DT, STEPS = 9.81, 1e-3, 60
NOISE = {"position": 1e-4, "angle": 2e-3}
NAMES = ["near", "far"]
PARTS = ("position", "rotation", "velocity", "spin")
FREE = [f"start.ball.{part}" for part in PARTS]
TRUTH = [
    Start(*(jnp.asarray(x) for x in ([0.1, 0.0, 0.5], [0.3, -1.0, 2.0], [1.0, -0.5, 2.0], [3.0, 0.0, -5.0]))),
    Start(*(jnp.asarray(x) for x in ([-2.0, 0.3, 0.2], [0.0, 3.0, 0.5], [0.0, 0.2, -1.0], [0.0, 9.0, 1.0]))),
]


def scene(centre=None, **body) -> Scene:
    """A ball that nothing touches; its centre of mass is where it is said to be."""
    if centre is not None:
        body |= {"centre": centre, "inertia": (1e-3,) * 3}
    return Scene(
        object={"ball": Object(Sphere(0.1), None, Body(1.0, **body)), "floor": Object(Plane())},
        world=World(gravity=(0.0, 0.0, -G)),
    )


def part(start: Start, name: str) -> np.ndarray:
    value = getattr(start, name)
    assert value is not None
    return np.array(value)


def thrown(start: Start, seed: int, sigma=1.0) -> Recording:
    """What a tracker sees of free flight: a parabola and a uniform turn."""
    t = DT * np.arange(0, STEPS + 1, 3)
    position, turn, velocity, spin = (part(start, name) for name in PARTS)
    random = np.random.default_rng(seed)
    place = position + np.outer(t, velocity) - 0.5 * G * np.outer(t * (t + DT), [0, 0, 1.0])
    place = place + sigma * NOISE["position"] * random.standard_normal(place.shape)
    turns = Rotation.from_rotvec(np.outer(t, spin)) * Rotation.from_rotvec(turn)
    turns = turns * Rotation.from_rotvec(sigma * NOISE["angle"] * random.standard_normal(place.shape))
    pose = np.concatenate([place, turns.as_quat(scalar_first=True)], axis=1)[:, None]
    return Recording(hip=np.full((STEPS, 1, 3), 9.0), hip_t=DT * np.arange(STEPS), pose=pose, pose_t=t)


RECORDINGS = [thrown(start, seed) for seed, start in enumerate(TRUTH)]


def numbers(start: Start) -> np.ndarray:
    return np.concatenate([part(start, name) for name in PARTS])


@pytest.mark.slow
def test_the_starts_of_two_throws_are_found_together():
    result = fit(scene(), RECORDINGS, FREE, each=FREE, noise=NOISE, starts=1, names=NAMES)
    assert result.converged
    for name, truth in zip(NAMES, TRUTH, strict=True):
        found = [p for key, p in result.parameters.items() if key.endswith(f" @ {name}")]
        estimates = np.array([p.estimate for p in found], float)
        errors = np.array([p.standard_error for p in found], float)
        assert np.all(np.abs(estimates - numbers(truth)) < 4 * errors)
        assert np.all(errors < np.repeat([1e-3, 0.02, 0.02, 0.2], 3))
        np.testing.assert_allclose(numbers(result.starts_of(name)["ball"]), estimates)


def test_they_begin_where_the_first_poses_have_them():
    """Uniform motion through 20 ms: gravity bends it by 0.1 m/s."""
    recordings = [thrown(start, 0, sigma=0.0) for start in TRUTH]
    found = starts_of(scene(), recordings, FREE)["ball"]
    for row, truth in enumerate(TRUTH):
        for name, close in zip(PARTS, (5e-4, 1e-9, 0.11, 1e-9), strict=True):
            np.testing.assert_allclose(part(found, name)[row], part(truth, name), atol=close)


def test_the_velocity_is_that_of_the_centre_of_mass():
    centre, start = np.array([0.02, 0.0, 0.05]), TRUTH[0]
    arm = Rotation.from_rotvec(part(start, "rotation")).apply(centre)
    backwards = jnp.asarray(-np.cross(part(start, "spin"), arm))
    still = thrown(Start(start.position, start.rotation, backwards, start.spin), 0, 0.0)
    found = starts_of(scene(tuple(centre)), [still], ["start.ball.velocity"])["ball"]
    np.testing.assert_allclose(part(found, "velocity"), [[0, 0, 0]], atol=0.11)
    assert found.position is None and found.spin is None


def test_what_was_not_measured_is_at_rest_where_the_scene_has_it():
    unseen = Recording(
        hip=np.full((9, 1, 3), 9.0),
        hip_t=DT * np.arange(9),
        force=np.zeros((9, 1, 3)),
        force_t=DT * np.arange(9),
    )
    found = starts_of(scene(), [unseen], FREE)["ball"]
    np.testing.assert_array_equal(numbers(found).reshape(4, 3), np.zeros((4, 3)))


def test_a_state_begins_as_it_is_told(dtype):
    start = jax.tree.map(lambda x: jnp.asarray(x, dtype), TRUTH[0])
    told = jax.tree.map(lambda x: jnp.asarray(x, dtype), scene())
    motion = begun(told, {"ball": start}, jnp.full((1, 3), 9.0, dtype), None).motion["ball"]
    turn = Rotation.from_quat(np.asarray(motion.orientation), scalar_first=True)
    np.testing.assert_allclose(turn.as_rotvec(), part(start, "rotation"), atol=1e-6)
    for name in ("position", "velocity", "spin"):
        value = getattr(motion, name)
        np.testing.assert_array_equal(value, part(start, name))
        assert value.dtype == dtype


@pytest.mark.slow
def test_on_the_command_line_as_any_number(tmp_path):
    files = [str(tmp_path / f"{name}.npz") for name in NAMES]
    for file, recording in zip(files, RECORDINGS, strict=True):
        recording.save(file)
    save_scene(scene(), tmp_path / "ball.toml")
    line = [
        "fit",
        *files,
        "--scene",
        str(tmp_path / "ball.toml"),
        "--starts",
        "1",
        "--json",
        str(tmp_path / "f"),
    ]
    assert cli.main([*line, "--free", *FREE, "--each", *FREE]) == 0
    assert f'"start.ball.velocity[2] @ {files[1]}"' in (tmp_path / "f").read_text()


@pytest.mark.parametrize(
    ("path", "body", "message"),
    [
        ("start.floor.velocity", {}, "start.floor.velocity: floor does not move; allowed: start.ball"),
        ("start", {}, "start: an object without a name does not move"),
        ("start.ball.speed", {}, "a start has no speed; allowed: start.ball.position, start.ball.rotation"),
        ("start.ball", {}, "a start has no part without a name"),
        ("start.ball.spin", {"rotation": False}, "the body does not rotate; allowed: start.ball.velocity"),
        ("start.ball.velocity[3]", {}, r"out of range; allowed: start.ball.velocity\[0\] to \[2\]"),
    ],
)
def test_starts_that_nothing_has(path, body, message):
    with pytest.raises(InputError, match=message):
        fit(scene(**body), RECORDINGS, [path])
