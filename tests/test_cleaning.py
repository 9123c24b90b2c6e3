"""Cleaning: each fault is repaired or reported, in words, and a clean recording is left as it is."""

from typing import Any

import numpy as np
import pytest

from hapjax import InputError, Recording, load_recording

N = 1000


def clean(seed=0) -> dict[str, Any]:
    """A finger that moves and rests, its force and an object's pose, each with its own clock."""
    t = 1e-3 * np.arange(N)
    path = np.stack([0.02 * np.sin(5 * t), 0 * t, np.maximum(0.01 * np.cos(9 * t), 0)], axis=-1)[:, None]
    rng = np.random.default_rng(seed)
    force = np.maximum(100 * path, 0)[::10] + 0.02 * rng.standard_normal((N // 10, 1, 3))
    pose = np.tile([0.1, 0.2, 0.3, 1, 0, 0, 0], (N // 4, 1)) + [1e-4, 0, 0, 0, 0, 0, 0] * rng.standard_normal(
        (N // 4, 1)
    )
    return dict(
        hip=path,
        hip_t=t,
        force=force,
        force_t=t[::10] + 3e-4,
        pose=pose,
        pose_t=t[::4] * (1 + 0.01 * np.sin(t[::4])),
    )


def loaded(tmp_path, arrays) -> Recording:
    """Through a file, since that is how recordings come in."""
    np.savez(tmp_path / "a.npz", **arrays)
    return load_recording(tmp_path / "a.npz")


@pytest.mark.parametrize("seed", range(3))
def test_a_clean_recording_stays_as_it_is(tmp_path, seed):
    arrays = clean(seed)
    recording = loaded(tmp_path, arrays)
    assert recording.findings == ()
    for name, array in arrays.items():
        np.testing.assert_array_equal(np.squeeze(getattr(recording, name)), np.squeeze(array), err_msg=name)


def nan(a):
    a["hip"][[10, 500, 501], 0, 2] = np.nan


def infinite_time(a):
    a["force_t"][7] = np.inf


def untracked(a):
    a["pose"][20:23, 3:] = 0


def twice(a):
    for name in ("hip", "hip_t"):
        a[name] = np.insert(a[name], 101, a[name][100], axis=0)


def out_of_order(a):
    a["hip_t"][[300, 301]] = a["hip_t"][[301, 300]]


def glitch_ahead(a):
    a["hip_t"][300] += 1e6


def set_back(a):
    a["force_t"][95:] -= 0.04


def held(a):
    a["force"] = np.repeat(a["force"], 10, axis=0)
    a["force_t"] = 1e-3 * np.arange(N)


def spike(a):
    a["hip"][400, 0, 1] += 0.2


def gap(a):
    for name in ("hip", "hip_t"):
        a[name] = np.delete(a[name], slice(600, 650), axis=0)


def pause(a):
    a["hip_t"][500:] += 60.0


def far_ahead(a):
    a["hip_t"][-1] += 1000.0


def far_behind(a):
    a["pose_t"][0] -= 1e5


def milliseconds(a):
    for name in ("hip_t", "force_t", "pose_t"):
        a[name] = 1e3 * a[name]


# The fault, what is found: channel, kind, where in s, how many; and how many samples the channel loses.
FAULTS = {
    "NaN": (nan, ("hip", "not a number", 0.010, 3), 3),
    "infinite time": (infinite_time, ("force", "not a number", np.inf, 1), 1),
    "untracked": (untracked, ("pose", "no orientation", 0.08, 3), 3),
    "repeated": (twice, ("hip", "repeated sample", 0.100, 1), 1),
    "out of order": (out_of_order, ("hip", "time goes back", 0.301, 1), 1),
    "glitch of the clock": (glitch_ahead, ("hip", "time goes back", 1000000.3, 1), 1),
    "clock set back": (set_back, ("force", "time goes back", None, 4), 4),
    "held": (held, ("force", "held samples", None, 900), 0),
    "spike": (spike, ("hip", "outlier", 0.400, 1), 1),
    "dropout": (gap, ("hip", "dropout", 0.599, 1), 0),
    "pause": (pause, ("hip", "time jump", 0.499, 1), 0),
    "last far ahead": (far_ahead, ("hip", "time jump", 1000.999, 1), 1),
    "first far behind": (far_behind, ("pose", "time jump", -1e5, 1), 1),
    "milliseconds": (milliseconds, ("hip", "time unit", None, 1), 0),
}


@pytest.mark.parametrize(("fault", "expected", "fewer"), FAULTS.values(), ids=FAULTS)
def test_each_fault_is_found(tmp_path, fault, expected, fewer):
    arrays = clean()
    fault(arrays)
    recording = loaded(tmp_path, arrays)
    channel, kind, at, count = expected
    (finding,) = recording.findings
    assert (finding.channel, finding.kind, finding.count) == (channel, kind, count), finding
    assert at is None or finding.at == pytest.approx(at, abs=1e-4)
    assert channel in finding.sentence and finding.done and "\n" not in str(finding)
    size = clean()[channel].shape[0] if kind == "held samples" else len(arrays[channel])
    assert len(getattr(recording, channel)) == size - fewer


def test_what_is_dropped_leaves_the_rest_in_place(tmp_path):
    arrays = clean()
    for fault in (nan, spike, twice, held):
        fault(arrays)
    recording = loaded(tmp_path, arrays)
    wanted = np.delete(np.arange(N), [10, 400, 500, 501])
    np.testing.assert_array_equal(recording.hip, clean()["hip"][wanted])
    np.testing.assert_array_equal(recording.hip_t, clean()["hip_t"][wanted])
    np.testing.assert_array_equal(recording.force, clean()["force"])
    assert len(recording.findings) == 4


def test_a_quantised_path_that_rests_is_not_held(tmp_path):
    arrays = clean()
    arrays["hip"] = np.round(arrays["hip"], 4)
    assert loaded(tmp_path, arrays).findings == ()


def test_a_clock_that_goes_back_for_long_is_refused(tmp_path):
    arrays = clean()
    arrays["hip_t"][500:] -= 0.3
    with pytest.raises(InputError, match=r"a\.npz, hip, row \d+: .*299 of 1000 samples"):
        loaded(tmp_path, arrays)


def test_a_clock_that_jumps_far_ahead_in_the_middle_is_refused(tmp_path):
    """By loading, and by what would have to go through the pause where it was not cleaned."""
    arrays = clean()
    arrays["hip_t"][500:] += 1e4
    with pytest.raises(InputError, match=r"a\.npz, hip, row 499: .*jumps ahead by 1e\+04 s"):
        loaded(tmp_path, arrays)
    with pytest.raises(
        InputError, match=r"hip, row 499 at 0\.499 s: .* 1 s of samples and a jump ahead by 1e"
    ):
        Recording.load(tmp_path / "a.npz").hip_every(1e-3)


def test_a_refusal_names_the_row_in_the_file(tmp_path):
    """Also where samples before it were dropped."""
    arrays = clean()
    nan(arrays)
    arrays["pose"][[3, 5]] = np.nan
    arrays["pose"][100, 3] = 2.0
    with pytest.raises(InputError, match=r"a\.npz, pose, row 100: .*norm 1"):
        loaded(tmp_path, arrays)


@pytest.mark.parametrize(
    ("channel", "value", "said"), [("force", np.nan, "NaN or infinite"), ("pose", 0.0, "quaternion 0")]
)
def test_a_channel_without_one_number_is_refused(tmp_path, channel, value, said):
    arrays = clean()
    arrays[channel][:] = value
    with pytest.raises(InputError, match=rf"a\.npz, {channel}: expected numbers, found none: .*{said}"):
        loaded(tmp_path, arrays)


def test_load_as_it_is_refuses_what_cleaning_repairs(tmp_path):
    arrays = clean()
    nan(arrays)
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match="hip, row 10"):
        Recording.load(tmp_path / "a.npz")
