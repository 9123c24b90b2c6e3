"""No force that goes to a device is ever NaN, infinite, over the limit, or there all at once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hapjax import InputError
from hapjax_devices import Limits, Safety
from hapjax_devices.event import Diary

FAST = Limits(slew=np.inf, ramp=0.0)  # the first force is none, that is all


def passed(safety, forces, first=0):
    """What goes out of the forces (T, F, 3) of ticks."""
    rows = np.asarray(forces).tolist()
    return np.array(
        [[safety(t, finger, f) for finger, f in enumerate(row)] for t, row in enumerate(rows, first)]
    )


def let_in(*arguments, **options):
    """A safety whose fingers are all in."""
    safety = Safety(*arguments, **options)
    passed(safety, np.zeros((1, len(arguments[0]), 3)), first=-1)
    return safety


@given(arrays(np.float64, (4, 3, 3), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_whatever_comes_in_finite_and_limited_goes_out(forces):
    limits = np.array([8.5, 1.0, 1e-3])
    for safety in (let_in(limits.tolist(), 1000.0), let_in(limits.tolist(), 1000.0, FAST)):
        out = passed(safety, forces)
        assert np.all(np.isfinite(out))
        assert np.all(np.linalg.norm(out, axis=2) <= limits)


@given(arrays(np.float32, (2, 2, 3), elements=st.floats(width=32, allow_nan=True, allow_infinity=True)))
def test_the_same_in_float32(forces):
    out = passed(let_in([8.5, 2.0], 1000.0, FAST), forces)
    assert np.all(np.isfinite(out)) and np.all(np.linalg.norm(out, axis=2) <= [8.5, 2.0])


def test_a_force_within_the_limits_passes_untouched():
    forces = np.random.default_rng(0).normal(size=(200, 2, 3))  # no blow: below 4 N
    safety = let_in([8.5, 8.5], 1000.0)
    np.testing.assert_array_equal(passed(safety, forces), forces)
    assert all(vars(counts) == dict.fromkeys(vars(counts), 0) for counts in (*safety.counts, safety.total))


def test_over_the_limit_the_direction_stays_and_the_norm_counts():
    safety = let_in([5.0, 5.0], 1000.0, [FAST, Limits(2.0, np.inf, 0.0)])
    # No axis of the second is over 2 N, but its norm is.
    out = passed(safety, [[[30.0, 40.0, 0.0], [1.5, 1.5, 1.5]]])
    np.testing.assert_allclose(out, [[[3.0, 4.0, 0.0], [2 / 3**0.5] * 3]], rtol=1e-12)
    assert [counts.limited for counts in safety.counts] == [1, 1] and safety.total.limited == 2
    # A user's limit does not lift the device's own.
    safety = let_in([5.0], 1000.0, Limits(50.0, np.inf, 0.0))
    np.testing.assert_allclose(passed(safety, [[[0, 0, 9.0]]]), [[[0, 0, 5.0]]])


def test_a_force_that_is_not_finite_becomes_none_and_the_next_ones_rise():
    safety = let_in([8.5, 8.5], 100.0, Limits(ramp=0.1))
    forces = np.tile([1.0, 2.0, 2.0], (30, 2, 1))
    passed(safety, forces, first=0)
    forces[5, 0, 1], forces[6, 0, 2] = np.nan, -np.inf
    out = passed(safety, forces, first=30)
    np.testing.assert_array_equal(out[:, 1], forces[:, 1])
    assert not out[5:7, 0].any()
    share = np.clip((np.arange(7, 30) - 7) / 10, 0, 1)
    np.testing.assert_allclose(out[7:, 0], share[:, None] * [1.0, 2.0, 2.0])
    assert [(c.not_finite, c.ramped) for c in safety.counts] == [(2, 10), (0, 0)]


def test_a_finger_that_is_let_in_deep_inside_rises_and_one_that_is_free_need_not():
    """The second is free at first, and touches before the first one's ramp is over."""
    safety = Safety([8.5, 8.5], 1000.0, Limits(ramp=0.2))
    forces = np.zeros((300, 2, 3))
    forces[:, 0, 0] = 3.0
    forces[50:, 1, 2] = np.minimum(0.1 * np.arange(250), 2.0)
    out = passed(safety, forces)
    np.testing.assert_allclose(out[:, 0, 0], 3.0 * np.clip(np.arange(300) / 200, 0, 1))
    np.testing.assert_array_equal(out[:, 1], forces[:, 1])
    assert [counts.ramped for counts in safety.counts] == [200, 0]
    safety.cut(1)
    again = passed(safety, np.full((201, 2, 3), 1.0), first=300)
    assert not again[0, 1].any() and np.all(again[0, 0] == 1)
    np.testing.assert_allclose(again[:, 1, 0], np.arange(201) / 200)
    safety.cut_all()
    assert not passed(safety, np.ones((1, 2, 3)), first=501).any()


def test_a_force_rises_and_turns_as_fast_as_it_may_and_falls_at_once():
    limits = Limits(slew=500.0, ramp=0.0)  # 0.5 N a tick
    safety = let_in([8.5], 1000.0, limits)
    rising = passed(safety, np.tile([0.0, 0.0, 2.0], (6, 1, 1)))[:, 0, 2]
    np.testing.assert_allclose(rising, [0.5, 1.0, 1.5, 2.0, 2.0, 2.0])
    assert safety.counts[0].slewed == 3
    np.testing.assert_array_equal(passed(safety, [[[0.0, 0, 0.25]]]), [[[0, 0, 0.25]]])
    np.testing.assert_allclose(passed(safety, [[[0.0, 0, -3.0]]]), [[[0, 0, -0.5]]])  # by none, and on
    passed(safety, np.tile([0.0, 0.0, -3.0], (6, 1, 1)))
    # Across: from the nearest of those that it may fall to.
    np.testing.assert_allclose(passed(safety, [[[4.0, 0, -1.0]]]), [[[0.5, 0, -1.0]]], atol=1e-12)
    assert safety.counts[0].slewed == 9


@given(arrays(np.float64, (12, 3), elements=st.floats(-20, 20)), st.floats(10, 5000))
def test_no_step_is_longer_than_the_slew_from_what_was_or_less(forces, slew):
    out = passed(let_in([8.5], 1000.0, Limits(slew=slew, ramp=0.0)), forces[:, None])[:, 0]
    last = np.concatenate([np.zeros((1, 3)), out[:-1]])
    shares = np.linspace(0, 1, 401)[:, None, None]
    nearest = np.linalg.norm(out - shares * last, axis=-1).min(axis=0)
    assert np.all(nearest <= slew / 1000 + 8.5 / 400)


def test_what_a_quick_hand_feels_of_a_stiff_wall_is_left_alone():
    """4000 N/m at 1 m/s and 1 kHz, and back."""
    depth = np.concatenate([np.arange(3), np.arange(2, -1, -1)]) * 1e-3 * 0.99
    forces = np.zeros((6, 1, 3))
    forces[:, 0, 2] = 4000 * depth
    safety = let_in([8.5], 1000.0)
    np.testing.assert_array_equal(passed(safety, forces), forces)


def test_what_wants_to_know_before_gets_what_the_device_can_do():
    safety = let_in([2.0, 2.0], 1000.0)
    out = safety.within(np.array([[0.0, 0.0, 4.0], [np.nan, 0.0, 0.0]], np.float32))
    np.testing.assert_allclose(out, [[0, 0, 2.0], [0, 0, 0]])
    assert [(c.limited, c.not_finite) for c in safety.counts] == [(1, 0), (0, 1)]


def test_spells_are_told_once_each_with_their_finger():
    diary = Diary(100.0)
    safety = Safety([2.0, 2.0], 100.0, Limits(slew=np.inf, ramp=0.05), diary)
    for tick in range(60):
        diary.turn(tick, 10**7 * tick)
        safety(tick, 0, (0.0, 0.0, 1.0 if tick != 40 else np.nan))
        safety(tick, 1, (0.0, 0.0, 3.0 if 10 <= tick < 20 else 0.0))
    diary.end()
    told = [(e.tick, e.finger, e.kind, e.sentence.split(": ")[1]) for e in diary.events]
    assert told == [
        (0, 0, "ramped", "begins at tick 0"),
        (10, 1, "limited", "begins at tick 10"),
        (4, 0, "ramped", "5 in the ticks 0 to 4"),
        (19, 1, "limited", "10 in the ticks 10 to 19"),
        (40, 0, "not_finite", "begins at tick 40"),
        (41, 0, "ramped", "begins at tick 41"),
        (40, 0, "not_finite", "1 in the ticks 40 to 40"),
        (45, 0, "ramped", "5 in the ticks 41 to 45"),
    ]
    assert [e.time_ns for e in diary.events] == [10**7 * e.tick for e in diary.events]
    heard = []
    diary.tell(heard.append)
    diary.tell(heard.append)
    assert heard == diary.events


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: Limits(force=0.0), "force of the limits is 0.0 N"),
        (lambda: Limits(slew=np.nan), "slew of the limits is nan N/s"),
        (lambda: Limits(ramp=-1.0), "ramp of the limits is -1.0 s"),
        (lambda: Safety([1.0, 2.0], 1000.0, [Limits()]), "limits has 1 items; allowed: 2"),
    ],
)
def test_refusals(made, said):
    with pytest.raises(InputError, match=said):
        made()
