"""Regressors, weights, drifts and alignment of motions, each against its formula."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.fft import dct

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction import motion_terms, paired
from rigtool.experiments.friction.inverse_dynamics import (
    Dynamics,
    _centred,
    _choice,
    _fit,
    _require_friction,
    _require_model,
    _resolves_inertia,
    _single_frequency,
    _times,
    _with_all_that_fits,
)
from rigtool.experiments.friction.motion_terms import (
    DYNAMICS_PARAMETERS,
    MIN_SLIDING_WEIGHT,
    NEAR_STANDSTILL,
    SmoothedMotion,
    _highest_frequency,
    band_limit,
    drift_terms,
    independent,
    weighted,
    with_drift,
)
from rigtool.experiments.friction.paired import MotionSignals, ParameterChange
from rigtool.numerics.smoothing import CUTOFF, KernelSmoother

SPACING, COUNT = 2e-3, 3000
TIME = SPACING * np.arange(COUNT)
TRUE = np.array([2e-5, 1e-4, 3e-3, 0.5e-3])


def motion(seed=1, noise=2e-5, spacing=SPACING, drift=0, hertz=(7.0, 17.0), low=2.0):
    """Return a recording whose regressors are known functions of time."""
    time = spacing * np.arange(COUNT)
    speed = 20 * np.cos(hertz[0] * time) + 9 * np.cos(hertz[1] * time + 1)
    acceleration = -20 * hertz[0] * np.sin(hertz[0] * time)
    acceleration = acceleration - 9 * hertz[1] * np.sin(hertz[1] * time + 1)
    design = np.column_stack(
        [acceleration, speed, np.tanh(speed / 3), np.ones(COUNT), np.abs(speed)]
    )
    torque = design[:, :4] @ TRUE + noise * np.random.default_rng(seed).standard_normal(COUNT)
    sliding = np.stack([np.abs(speed) > limit * low for limit in (1.0, 0.5, 0.25, 0.0)])
    position = np.cumsum(speed) * spacing + seed
    return SmoothedMotion(
        design,
        torque,
        position,
        sliding[0],
        sliding,
        spacing,
        (0.01, 0.5),
        50.0,
        4 * COUNT,
        4,
        False,
        drift,
    )


# -- regressors


def test_regressors_are_those_of_the_smoothed_motion():
    """Two sines: slopes by a kernel of the chosen width, signs of the speed between samples."""
    step = 1e-3
    time = step * np.arange(20000)
    position = 1.5 * np.sin(3 * time) + 0.2 * np.sin(11 * time)
    torque = np.cos(5 * time)
    found = band_limit(time=time, position=position, torque=torque, cutoff=20.0)
    smoother = KernelSmoother(step, CUTOFF / 20.0)
    assert found.cutoff == pytest.approx(20.0)
    assert (found.every, found.spacing) == (smoother.every, smoother.every * step)
    places = smoother.places(20000)
    at = time[places]
    inside = slice(20, -20)
    kept = [math.exp(-((w * smoother.width) ** 2) / 2) for w in (3, 11, 5)]
    speed = 4.5 * kept[0] * np.cos(3 * at) + 2.2 * kept[1] * np.cos(11 * at)
    bent = -13.5 * kept[0] * np.sin(3 * at) - 24.2 * kept[1] * np.sin(11 * at)
    assert_allclose(found.design[inside, 1], speed[inside], atol=2e-3)
    assert_allclose(found.design[inside, 0], bent[inside], atol=2e-2)
    assert_allclose(found.torque[inside], kept[2] * np.cos(5 * at)[inside], atol=1e-3)
    assert_allclose(found.position, position[places])
    every = np.interp(np.arange(20000), places, found.design[:, 1])
    assert_allclose(found.design[:, 2], smoother(np.sign(every)))
    assert_allclose(found.design[:, 3], 1.0)
    assert_allclose(found.design[:, 4], smoother(np.abs(every)))
    highest = np.percentile(np.abs(found.design[:, 1]), 99)
    for row, part in zip(found.sliding, NEAR_STANDSTILL, strict=True):
        fast = np.abs(every) >= max(part * highest, 5 * found.noise[0]) if part else every == every
        assert_array_equal(row, smoother(fast.astype(float)) >= MIN_SLIDING_WEIGHT)
    assert_array_equal(found.used, found.sliding[0])
    assert found.left_out == 20000 - found.used.sum() * found.every
    assert not found.resampled
    assert found.samples == 20000


@pytest.mark.parametrize("hertz", [0.5, 2.0])
def test_a_kernel_passes_ten_harmonics_of_the_motion(hertz):
    time = 1e-3 * np.arange(20000)
    position = np.floor(500 * np.sin(2 * np.pi * hertz * time)) / 500
    found = band_limit(time=time, position=position, torque=time)
    assert found.cutoff <= 10 * hertz * 1.3
    exact = _highest_frequency(np.sin(2 * np.pi * hertz * time), 1e-3)
    assert exact == pytest.approx(hertz, abs=2.5 / 20)


def test_a_recording_in_which_hardly_anything_moves_is_refused():
    rng = np.random.default_rng(1)
    time = 1e-3 * np.arange(5000)
    still = 1e-3 * rng.standard_normal(5000)
    with pytest.raises(InsufficientDataError, match="nothing moves"):
        band_limit(time=time, position=still, torque=time)


# -- drift and weights


def test_slow_cosines_are_those_of_a_cosine_transform():
    own = motion()
    values = np.random.default_rng(2).standard_normal(COUNT)
    assert_allclose(own.slow(5).T @ values, dct(values, type=2)[1:6] / 2, atol=1e-9)


def test_rows_without_a_drift_have_the_fit_that_includes_it():
    own = motion(drift=3)
    own = replace(own, torque=own.torque + own.slow(3) @ [1e-3, -2e-3, 5e-4])
    design, torque = own.rows()
    used = own.used
    whole = np.column_stack([own.design[:, :4], own.slow(3)])[used]
    expected = np.linalg.lstsq(whole, own.torque[used], rcond=None)[0][:4]
    found = np.linalg.lstsq(design[used, :4], torque[used], rcond=None)[0]
    assert_allclose(found, expected, rtol=1e-6)
    plain = replace(own, drift=0).rows()
    assert plain[0] is own.design


def test_each_second_in_use_has_the_same_weight():
    parts = [motion(1), motion(2, spacing=8e-3, drift=2)]
    design, torque, weight = weighted(parts)
    expected = np.concatenate([p.used * math.sqrt(p.spacing) for p in parts])
    assert_allclose(weight, expected)
    rows = [p.rows() for p in parts]
    assert_allclose(torque, np.concatenate([t for _, t in rows]) * expected)
    assert_allclose(design, np.concatenate([d for d, _ in rows]) * expected[:, None])
    terms = drift_terms([replace(parts[0], drift=3), parts[1]])
    assert terms.shape == (2 * COUNT, 5)
    assert_allclose(terms[:COUNT, :3], parts[0].slow(3) * weight[:COUNT, None])
    assert_allclose(terms[COUNT:, 3:], parts[1].slow(2) * weight[COUNT:, None])
    assert not terms[:COUNT, 3:].any()
    assert not terms[COUNT:, :3].any()


@pytest.mark.parametrize(("reversals", "count"), [(7, 0), (8, 2), (23, 5), (47, 10)])
def test_a_drift_has_a_cosine_for_four_reversals(reversals, count):
    """Two at least, ten at most."""
    own = motion()
    speed = 20 * np.sin(np.pi * (reversals + 1) * (np.arange(COUNT) + 0.5) / COUNT)
    design = own.design.copy()
    design[:, 1], design[:, 2] = speed, np.tanh(speed / 3)
    slow = own.slow(2) @ [3e-3, 2e-3]
    noise = 1e-5 * np.random.default_rng(3).standard_normal(COUNT)
    own = replace(own, design=design, torque=design[:, :4] @ TRUE + slow + noise)
    (found,) = with_drift([own], [0, 1, 2, 3])
    assert found.drift == count


@pytest.mark.parametrize(("ratio", "drifts"), [(2.7, False), (3.3, True)])
def test_a_drift_has_three_times_the_power_of_the_next_cosines(ratio, drifts):
    own = motion(noise=0.0)
    turned = np.count_nonzero(np.diff(np.sign(own.design[:, 1])))
    count = min(turned // 4, 10)
    own = replace(own, used=np.ones(COUNT, dtype=bool))
    sizes = np.append(np.full(count, math.sqrt(ratio)), np.ones(2 * count)) * 1e-4
    slow = own.slow(3 * count) @ sizes
    chosen = [0, 1, 2]
    beside = own.design[:, chosen]
    own = replace(own, torque=slow - 0 * TIME)
    left = slow - beside @ np.linalg.lstsq(beside, slow, rcond=None)[0]
    power = np.linalg.lstsq(own.slow(3 * count), left, rcond=None)[0] ** 2
    shown = power[:count].mean() / power[count:].mean()
    (found,) = with_drift([own], chosen)
    assert bool(found.drift) == (shown > 3)
    assert shown == pytest.approx(ratio, rel=0.1)
    assert bool(found.drift) == drifts


def test_residuals_count_by_recordings_at_two_deviations_of_the_kernel(monkeypatch):
    seen = []

    def counted(part, used, lag):
        seen.append((part[0], len(part), lag))
        return 10.0 * len(seen)

    monkeypatch.setattr(motion_terms, "independent_samples", counted)
    parts = [motion(1), replace(motion(2), cutoff=5.0), replace(motion(3), cutoff=1e6)]
    assert independent(parts, np.arange(3.0 * COUNT)) == 60.0
    lags = [max(1, round(2 * CUTOFF / p.cutoff / p.spacing)) for p in parts]
    assert seen == [(COUNT * n, COUNT, lags[n]) for n in range(3)]
    assert lags[2] == 1 < lags[0] < lags[1]


# -- parameters


def found_of(parts, chosen=(0, 1, 2, 3)):
    return _fit(parts, [*chosen], 0.05, None)


def test_a_fit_states_what_it_leaves_and_explains():
    parts = [motion(1), motion(2)]
    found = found_of(parts)
    design, torque, weight = weighted(parts)
    solution = np.linalg.lstsq(design[:, :4], torque, rcond=None)[0]
    residual = torque - design[:, :4] @ solution
    assert_allclose(found.parameters[:4], solution)
    assert np.isnan(found.parameters[4:]).all()
    assert found.residual_rms == pytest.approx(math.sqrt(residual @ residual / (weight @ weight)))
    used = weight > 0
    unlike = (torque / np.maximum(weight, 1e-9))[used]
    assert found.explained == pytest.approx(
        1 - (residual @ residual) / np.sum(weight[used] ** 2 * (unlike - unlike.mean()) ** 2)
    )
    assert found.residual_rms == pytest.approx(2e-5, rel=0.05)
    assert (found.by_direction, found.is_late) == (False, False)
    assert_allclose(found.torque(parts[0]), parts[0].design[:, :4] @ solution)


def test_noise_of_the_acceleration_draws_the_inertia_towards_zero():
    """By its part of what the others leave of the acceleration: that much counts as uncertainty."""
    own = motion()
    own.design[:, 0] += 5 * own.design[:, 1]  # an acceleration that goes with the speed in part
    quiet, noisy = (replace(own, noise=(0.0, size)) for size in (0.0, 20.0))
    before, after = found_of([quiet]), found_of([noisy])
    design = weighted([quiet])[0][:, :4]
    others = design[:, 1:]
    rest = design[:, 0] - others @ np.linalg.lstsq(others, design[:, 0], rcond=None)[0]
    assert np.sum(rest**2) < 0.9 * np.sum(design[:, 0] ** 2)
    share = quiet.used.sum() * SPACING * 20.0**2 / np.sum(rest**2)
    more = (share * before.parameters[0]) ** 2
    assert after.covariance[0, 0] - before.covariance[0, 0] == pytest.approx(more, rel=1e-6)
    assert_allclose(after.covariance[1:4, 1:4], before.covariance[1:4, 1:4])
    assert more > before.covariance[0, 0] / 10


def test_sums_of_parameters_have_the_variance_of_their_covariance():
    rng = np.random.default_rng(5)
    root = rng.standard_normal((6, 6))
    own = replace(found_of([motion()]), parameters=np.arange(1.0, 7.0), covariance=root @ root.T)
    for names, factor in (
        (("viscous",), [0, 1, 0, 0, 0, 0]),
        (("viscous", "viscous_difference"), [0, 1, 0, 0, 1, 0]),
        (("viscous", "-viscous_difference"), [0, 1, 0, 0, -1, 0]),
    ):
        value, u = own.estimate(*names)
        assert value == pytest.approx(np.dot(factor, own.parameters))
        assert u == pytest.approx(math.sqrt(np.array(factor) @ own.covariance @ factor))
    assert (own.by_direction, own.is_late) == (True, True)


def test_the_choice_of_what_is_left_out_is_a_rectangle():
    own = motion(noise=2e-4)
    curved = own.torque + 1e-3 * np.exp(-np.abs(own.design[:, 1]) / 3) * np.sign(own.design[:, 1])
    own = replace(own, torque=curved, used=own.sliding[-1])
    whole = np.linalg.lstsq(own.design[own.used, :4], curved[own.used], rcond=None)[0]
    change = np.zeros(4)
    for used in own.sliding:
        there = np.linalg.lstsq(own.design[used, :4], curved[used], rcond=None)[0]
        change = np.maximum(change, np.abs(there - whole))
    assert_allclose(_choice([own], [0, 1, 2, 3], whole), change / math.sqrt(3), rtol=1e-6)


@pytest.mark.parametrize(("part", "refused"), [(0.005, True), (0.015, False)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_hundredth_of_the_motion_is_in_the_other_direction(part, refused, way):
    design = motion().design.copy()
    design[:, 1] = way * np.random.default_rng(9).uniform(2, 30, COUNT)
    design[: round(part * COUNT), 1] *= -1
    design[:, 2] = np.sign(design[:, 1])
    if not refused:
        _require_friction(design)
        return
    named = "positive" if way > 0 else "negative"
    with pytest.raises(InsufficientDataError, match=f"99.5 % of the motion is in the {named}"):
        _require_friction(design)


@pytest.mark.parametrize(("share", "resolved"), [(0.09, True), (0.11, False)])
def test_inertia_shows_where_noise_is_a_tenth_of_the_acceleration(share, resolved):
    own = motion()
    power = np.mean(own.design[own.used, 0] ** 2)
    own = replace(own, noise=(0.01, math.sqrt(share * power)))
    found, reason = _resolves_inertia([own, own])
    assert found == pytest.approx(share)
    assert (reason is None) == resolved
    if reason:
        assert "11 % of its power is noise" in reason
    slow = replace(own, design=own.design * 1e-6, noise=(0.0, own.noise[1] * 1e-6))
    assert _resolves_inertia([slow])[0] == pytest.approx(share)
    still = replace(own, design=own.design * [0, 1, 1, 1, 1])
    assert _resolves_inertia([still])[0] == math.inf
    alike = own.design.copy()
    alike[:, 0] = alike[:, 1] * 3 + 0.01 * alike[:, 2]
    _, reason = _resolves_inertia([replace(own, design=alike, noise=(0.0, 0.0))])
    assert "goes with the speed" in reason


def test_a_model_explains_half_of_the_variance_and_friction_is_above_zero():
    own = found_of([motion()])
    _require_model(own)
    _require_model(replace(own, explained=0.51))
    with pytest.raises(InsufficientDataError, match="explain 49 % of the torque's variance"):
        _require_model(replace(own, explained=0.49))
    for times, refused in ((2.9, False), (3.1, True)):
        u = own.estimate("coulomb")[1]
        turned = own.parameters.copy()
        turned[DYNAMICS_PARAMETERS.index("coulomb")] = -times * u
        below = replace(own, parameters=turned)
        assert isinstance(below, Dynamics)
        if not refused:
            _require_model(below)
            continue
        with pytest.raises(InsufficientDataError, match="cannot be below 0"):
            _require_model(below)


def test_parts_of_time_and_centred_positions_are_of_each_recording():
    parts = [motion(1), motion(5)]
    times = _times(parts)
    assert_array_equal(np.bincount(times), np.full(20, COUNT // 10))
    assert np.all(np.diff(times) >= 0)
    centred = _centred(parts)
    assert_allclose([centred[:COUNT].mean(), centred[COUNT:].mean()], 0, atol=1e-9)
    assert_allclose(np.diff(centred[:COUNT]), np.diff(parts[0].position))


@pytest.mark.parametrize(("mixed", "single"), [(0.0, True), (0.3, False)])
def test_one_frequency_has_a_position_against_the_acceleration(mixed, single):
    own = motion()
    position = np.sin(7 * TIME) + mixed * np.sin(31 * TIME)
    design = own.design.copy()
    design[:, 0] = -49 * np.sin(7 * TIME) - mixed * 961 * np.sin(31 * TIME)
    assert _single_frequency([replace(own, design=design, position=position)]) == single


# -- pairs


def change(names, parameters, covariance, turns=True, **given):
    none = np.zeros(4)
    own = {"difference": none, "model": none, "used": np.ones(4, dtype=bool), **given}
    return ParameterChange(
        names,
        np.array(parameters),
        np.array(covariance),
        9,
        0.0,
        none,
        none,
        none,
        own["difference"],
        own["model"],
        own["used"],
        4.0,
        0.0,
        turns,
    )


def test_gravity_is_the_length_of_its_change_with_the_u_along_it():
    rng = np.random.default_rng(6)
    root = rng.standard_normal((3, 3))
    own = change(("inertia", "gravity_cosine", "gravity_sine"), [1.0, 3.0, -4.0], root @ root.T)
    value, u = own.gravity()
    drawn = rng.multivariate_normal([1.0, 3.0, -4.0], 1e-8 * root @ root.T, 20000)
    assert value == 5.0
    assert u == pytest.approx(1e4 * np.hypot(*drawn.T[1:]).std(), rel=0.03)
    assert own.estimate("inertia") == pytest.approx((1.0, math.sqrt((root @ root.T)[0, 0])))
    assert own.estimate("viscous") is None
    without = change(("inertia", "viscous"), [1.0, 2.0], np.diag([4.0, 9.0]))
    assert without.gravity() is None
    assert without.estimate("inertia") is None  # gravity's change may be part of it
    assert without.estimate("viscous") == (2.0, 3.0)
    level = change(("inertia", "viscous"), [1.0, 2.0], np.diag([4.0, 9.0]), turns=False)
    assert level.estimate("inertia") == (1.0, 2.0)


def test_what_a_change_leaves_is_the_difference_beside_the_model():
    own = change(
        ("viscous",),
        [1.0],
        [[1.0]],
        difference=np.array([1.0, 2, 3, 90]),
        model=np.array([2.0, 2, 1, 1]),
        used=np.array([True, True, True, False]),
    )
    assert own.residual_rms == pytest.approx(math.sqrt(5 / 3))


def test_a_covariance_gets_back_what_moments_lost():
    rng = np.random.default_rng(7)
    design = rng.standard_normal((50, 3))
    gram, root = design.T @ design, rng.standard_normal((50, 50))
    loss = np.array([0.5, 0.8, 0.9])
    lost = design * loss  # moments X' R X of which each column kept a part
    spread = lost.T @ (root @ root.T) @ lost
    inverse = np.linalg.inv(gram)
    expected = inverse @ (design.T @ (root @ root.T) @ design) @ inverse
    assert_allclose(paired._scaled(inverse @ spread @ inverse, gram, loss), expected, rtol=1e-9)


def signals(late, seconds=20.0, seed=None, start=0.0):
    step = 5e-3
    time = step * np.arange(round(seconds / step))
    here = time - late + start
    position = np.sin(1.3 * here) + 0.5 * np.sin(3.1 * here + 1) + 0.2 * np.sin(0.7 * here)
    if seed is not None:
        position = position + 1e-3 * np.random.default_rng(seed).standard_normal(len(time))
    return time, position


@pytest.mark.parametrize("late", [-3.21, -0.003, 0.0, 1.777, 4.0])
def test_runs_of_one_motion_are_shifted_onto_each_other(late):
    (time, position), (other, moved) = signals(0.0), signals(late, 18.0)
    assert paired._shift(time, position, other, moved) == pytest.approx(late, abs=1e-4)


@pytest.mark.parametrize("off", [-0.1, 0.15])
def test_a_shift_is_refined_by_least_squares(off):
    (time, position), (other, moved) = signals(0.0, seed=1), signals(0.4, seed=2)
    rms, found = paired._refined(time, position, other, moved, 0.4 + off)
    assert found == pytest.approx(0.4, abs=5e-4)
    assert rms == pytest.approx(math.sqrt(2) * 1e-3, rel=0.2)


@pytest.mark.parametrize(("overlap", "tried"), [(0.45, False), (0.55, True)])
def test_half_of_the_shorter_run_is_compared_at_least(overlap, tried):
    shift = -(20.0 - overlap * 12.0)
    (time, position), (other, moved) = signals(0.0, 20.0), signals(shift, 12.0)
    rms, _ = paired._refined(time, position, other, moved, shift)
    assert math.isfinite(rms) == tried


@pytest.mark.parametrize(("part", "refused"), [(0.09, False), (0.11, True)])
def test_motions_that_differ_by_a_tenth_are_others(part, refused):
    rng = np.random.default_rng(8)
    position = 5 * rng.standard_normal(4000)
    apart = rng.standard_normal(4000)
    apart = (apart - apart.mean()) / apart.std() * part * position.std()
    if not refused:
        paired._require_same(position, position + apart + 3.0)
        return
    with pytest.raises(InsufficientDataError, match=r"differ by 11 % rms.*limit is 10 %"):
        paired._require_same(position, position + apart + 3.0)


def test_runs_have_one_even_time_axis():
    time = np.array([*np.arange(0, 1, 0.01), *np.arange(1.5, 2.5, 0.01)])
    angle = 0.5 * time
    own = MotionSignals(time, 2 * time, 3 * time, angle)
    axis, position, effort, turned, known = paired._even(own)
    assert_allclose(np.diff(axis), axis[1], rtol=1e-9)
    assert axis[0] == 0
    for values, slope in ((position, 2.0), (effort, 3.0), (turned, 0.5)):
        assert_allclose(values[known], slope * (time[0] + axis)[known], atol=1e-6)
    assert 0.75 < known.mean() < 0.85  # not in the gap of half a second
    assert paired._even(replace(own, angle=None))[3] is None


def test_runs_that_overlap_entirely_are_compared_from_end_to_end():
    (time, position), (_, again) = signals(0.0), signals(0.0)
    runs = [MotionSignals(time, one, 3 * one) for one in (position, again, again[:3000])]
    runs[2] = replace(runs[2], time=time[:3000], effort=3 * again[:3000])
    axis, found, shifts = paired._aligned(runs[0], runs[1:2])
    assert_allclose(axis, time, atol=1e-9)
    assert shifts == pytest.approx([0.0], abs=1e-9)
    for values, effort, angle, known in found:
        assert_allclose(values, position, atol=1e-9)
        assert_allclose(effort, 3 * position, atol=1e-9)
        assert angle is None
        assert known.all()
    axis = paired._aligned(runs[0], runs[1:])[0]
    assert_allclose(axis, time[:3000], atol=1e-9)
    (_, late) = signals(1.5)
    axis, found, shifts = paired._aligned(runs[0], [MotionSignals(time, late, 3 * late)])
    assert shifts == pytest.approx([1.5], abs=1e-4)
    assert axis[0] == pytest.approx(0.0)
    assert axis[-1] == pytest.approx(time[-1] - 1.5, abs=6e-3)
    assert_allclose(found[1][0], found[0][0], atol=1e-3)


def test_runs_of_which_a_tenth_is_common_are_refused():
    (time, position) = signals(0.0)
    for begin, refused in ((17.5, False), (18.5, True)):
        _, late = signals(-begin)
        own, other = MotionSignals(time, position, position), MotionSignals(time, late, late)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(paired, "_shift", lambda *given, by=-begin: by)
            if refused:
                with pytest.raises(InsufficientDataError, match="less than a tenth"):
                    paired._aligned(own, [other])
            else:
                assert len(paired._aligned(own, [other])[0]) == pytest.approx(2.5 / 5e-3, abs=2)


@pytest.mark.parametrize(
    ("times", "shift", "standstill"),
    [(1.0, 0.0, 0.0), (2.0, 0.0, 0.05), (1.0, 6e-5, 0.05), (1.0, -6e-5, 0.05)],
)
def test_samples_near_standstill_that_the_model_fits_as_well_are_used(times, shift, standstill):
    """All of them, unless their residuals are larger than the others', or lean along the motion."""
    own = motion(low=8.0)
    rng = np.random.default_rng(10)
    slow = ~own.used
    noise = 2e-5 * rng.standard_normal(COUNT) * np.where(slow, times, 1.0)
    lean = np.where(slow, shift * np.sign(own.design[:, 1]), 0.0)
    own = replace(own, torque=own.design[:, :4] @ TRUE + noise + lean)
    (found,), part = _with_all_that_fits([own], [0, 1, 2, 3])
    assert part == standstill
    assert_array_equal(found.used, own.sliding[-1] if standstill == 0 else own.used)
