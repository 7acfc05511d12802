"""Steps of the fit of friction against speed, each against its formula written out."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rigtool.experiments.friction.direction_fit import peak
from rigtool.experiments.friction.stribeck_fit import (
    BUMP_SIGNIFICANCE,
    FAR_BEYOND,
    OTHER_VELOCITIES,
    _akaike,
    _averaged,
    _criterion,
    _curve,
    _determined,
    _line,
    _Points,
    _straight_part,
    fit_direction,
    fit_directions,
    mean_by_speed,
)

SPEEDS = np.array([0.2, 0.4, 0.7, 1.0, 2.0, 4.0, 8.0, 15.0, 30.0])


def corrected(residual, parameters):
    """The variance is one of the parameters."""
    return _akaike(residual, parameters - 1, known=False)


def points(v, f, u):
    return _Points(v, f, 1 / u, np.zeros(len(v)))


def line_of(v, f, u):
    """Return parameters, covariance without scatter, and residuals by the normal equations."""
    design = np.column_stack([np.ones(len(v)), v])
    normal = design.T @ (design / u[:, None] ** 2)
    found = np.linalg.solve(normal, design.T @ (f / u**2))
    return found, np.linalg.inv(normal), f - design @ found


@given(st.lists(st.floats(-3, 3), min_size=2, max_size=12), st.integers(1, 5))
def test_the_criterion_is_akaikescorrected(residual, k):
    """N. Sugiura 1978, C. M. Hurvich and C.-L. Tsai 1989, with an unknown variance."""
    n, square = len(residual), sum(one**2 for one in residual)
    if square < 1e-6:
        return
    expected = n * math.log(square / n) + 2 * k + 2 * k * (k + 1) / max(n - k - 1, 1)
    assert _akaike(np.array(residual), k - 1, known=False) == pytest.approx(
        expected, rel=1e-9, abs=1e-9
    )


@pytest.mark.parametrize("seed", range(5))
def test_holds_of_one_speed_are_one_point(seed):
    """Within 0.5 % of the next; their scatter counts where it exceeds their uncertainties."""
    rng = np.random.default_rng(seed)
    speeds, repeats = np.array([0.5, 1.0, 1.0060, 2.0, 3.0]), [1, 3, 2, 4, 1]
    v = np.concatenate(
        [s * (1 + 1e-3 * rng.uniform(0, 1, n)) for s, n in zip(speeds, repeats, strict=True)]
    )
    u = rng.uniform(1, 2, len(v))
    f = rng.standard_normal(len(v)) * np.where(v > 1.5, 5.0, 0.1)
    expected, first = [], 0
    for n in repeats:
        part = slice(first, first + n)
        first += n
        w = 1 / u[part] ** 2
        mean = np.average(f[part], weights=w)
        birge = 1.0 if n == 1 else max(1.0, np.sum(w * (f[part] - mean) ** 2) / (n - 1))
        expected.append((np.average(v[part], weights=w), mean, math.sqrt(birge / w.sum())))
    mixed = rng.permutation(len(v))
    assert_allclose(mean_by_speed(v[mixed], f[mixed], u[mixed]), np.transpose(expected), rtol=1e-9)


@pytest.mark.parametrize("scatter", [0.3, 3.0])
def test_a_line_is_that_of_the_normal_equations(scatter):
    rng = np.random.default_rng(2)
    u = rng.uniform(1e-5, 3e-5, len(SPEEDS))
    f = 2e-3 + 5e-5 * SPEEDS + scatter * u * rng.standard_normal(len(SPEEDS))
    found, (parameters, covariance, residual) = _line(points(SPEEDS, f, u)), line_of(SPEEDS, f, u)
    dof = len(SPEEDS) - 2
    birge = max(1.0, np.sum((residual / u) ** 2) / dof)
    assert (birge > 1) == (scatter > 1)
    assert_allclose(found.parameters, parameters, rtol=1e-9)
    assert_allclose(found.covariance, covariance * birge, rtol=1e-9)
    assert (found.dof, found.lowest, found.highest) == (dof, 0.2, 30.0)
    excess = np.sum(residual**2) / dof - np.mean((FAR_BEYOND * u) ** 2)
    assert found.structure == pytest.approx(math.sqrt(max(excess, 0.0)), rel=1e-9)
    assert found.worst_speed == SPEEDS[np.argmax(np.abs(residual))]
    assert found.friction == pytest.approx(f.mean())
    assert found.coulomb == pytest.approx((parameters[0], math.sqrt(covariance[0, 0] * birge)))
    assert found.viscous == pytest.approx((parameters[1], math.sqrt(covariance[1, 1] * birge)))
    assert found.static is None
    assert found.stribeck_velocity is None


def test_structure_is_what_residuals_have_beyond_three_times_the_scatter():
    u = np.linspace(1e-6, 2e-5, len(SPEEDS))
    f = 2e-3 + 5e-5 * SPEEDS + 1e-4 * np.cos(3 * SPEEDS)
    found, residual = _line(points(SPEEDS, f, u)), line_of(SPEEDS, f, u)[2]
    expected = math.sqrt(np.sum(residual**2) / (len(SPEEDS) - 2) - np.mean((3 * u) ** 2))
    assert found.structure == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("times", "left_out"), [(2.7, 0), (3.3, 1)])
def test_the_lowest_speed_is_left_out_three_uncertainties_off_the_line(times, left_out):
    u = np.full(len(SPEEDS), 2e-5)
    f = 2e-3 + 5e-5 * SPEEDS
    covariance = line_of(SPEEDS[1:], f[1:], u[1:])[1]
    design = np.array([1.0, SPEEDS[0]])
    off = math.sqrt(u[0] ** 2 + design @ covariance @ design)
    f[0] += times * off
    found = _straight_part(points(SPEEDS, f, u))
    assert found.lowest == SPEEDS[left_out]
    assert found.dof == len(SPEEDS) - 2 - left_out


def test_four_speeds_over_a_factor_of_two_are_left_at_least():
    u = np.full(6, 1e-6)
    off = np.array([1.0, 0.03, 2.1e-3, 2e-3, 2e-3, 2e-3])
    assert _straight_part(points(np.array([1.0, 2, 3, 4, 6, 8]), off, u)).dof == 4 - 2
    # what is left spans a factor of two from the second speed
    assert _straight_part(points(np.array([1.0, 4.2, 5, 6, 7, 8]), off, u)).lowest == 1.0
    assert _straight_part(points(np.array([1.0, 3.9, 4.2, 6, 7, 8]), off, u)).lowest == 3.9


def stribeck(v, static, velocity, exponent):
    return 2.3e-3 + 5e-5 * v + (static - 2.3e-3) * np.exp(-((v / velocity) ** exponent))


@pytest.mark.parametrize("static", [3.0e-3, 2.27e-3])
def test_the_stated_line_is_the_mean_over_models_by_their_akaike_weights(static):
    """Half of the weight is the line's before the data speak, the rest is shared by the shapes, and
    within a shape that is not determined by its velocities; friction that rises with speed is no
    Stribeck effect."""
    rng = np.random.default_rng(4)
    v = np.geomspace(0.4, 30, 9)
    u = np.full(9, 4e-5)
    f = stribeck(v, static, 0.5, 2.0) + u * rng.standard_normal(9)
    chosen, curves = _line(points(v, f, u)), {2.0: None, 1.0: None}
    found, covariance = _averaged(chosen, curves, points(v, f, u))

    line = _straight_part(points(v, f, u))
    out = v < line.lowest
    residual = np.where(out, 0.0, (f - line.evaluate(v)) / u)
    models = [(line.parameters, corrected(residual, 3 + out.sum()), 0.5, line.covariance)]
    for d in (2.0, 1.0):
        for vs in np.geomspace(v.min() / 3, v.max() / 3, OTHER_VELOCITIES):
            bump = np.exp(-((v / vs) ** d))
            design = np.column_stack([1 - bump, v, bump]) / u[:, None]
            p = np.linalg.lstsq(design, f / u, rcond=None)[0]
            if p[2] >= p[0]:
                rest = f / u - design @ p
                own = np.linalg.inv(design.T @ design)[:2, :2] * max(1.0, rest @ rest / 6)
                models.append((p[:2], corrected(rest, 4), 0.25 / OTHER_VELOCITIES, own))
    best = min(model[1] for model in models)
    weights = np.array([share * math.exp((best - one) / 2) for _, one, share, _ in models])
    weights /= weights.sum()
    lines = np.array([p for p, *_ in models])
    expected = weights @ lines
    assert_allclose(found, expected, rtol=1e-9)
    apart = lines - expected
    within = sum(w * own for w, (*_, own) in zip(weights, models, strict=True))
    assert_allclose(covariance, within + (apart * weights[:, None]).T @ apart, rtol=1e-6)
    assert 0.05 < weights[0] < (0.95 if static > 2.3e-3 else 1.0)


def _stribeck(known, exponent):
    fit = _curve(known, exponent)
    return fit if fit is not None and _determined(fit, known) else None


def test_a_curve_that_is_not_determined_rules_out_one_that_fits_worse():
    """Two speeds show a Gaussian effect; Tustin's, wider, is determined by the same ones."""
    v = np.geomspace(0.49, 14.7, 8)
    u = np.full(8, 1e-5)
    f = stribeck(v, 3.6e-3, 0.66, 2.0) + u * np.random.default_rng(3).standard_normal(8)
    known = points(v, f, u)
    assert _stribeck(known, 2.0) is None
    assert _stribeck(known, 1.0) is not None
    found = fit_direction(v, f, u)
    assert found.exponent is None
    assert found.criterion == pytest.approx(fit_direction(v, f, u, {}).criterion)


def test_a_chosen_curve_states_its_own_line_and_the_others_as_uncertainty():
    rng = np.random.default_rng(5)
    v = np.geomspace(0.1, 30, 20)
    u = np.full(20, 5e-5)
    f = stribeck(v, 4e-3, 0.8, 2.0) + u * rng.standard_normal(20)
    curves = {d: _stribeck(points(v, f, u), d) for d in (2.0, 1.0)}
    assert all(curves.values())
    found, covariance = _averaged(curves[2.0], curves, points(v, f, u))
    assert_allclose(found, curves[2.0].parameters[:2], rtol=1e-12)
    line = _straight_part(points(v, f, u))
    out = int(np.sum(v < line.lowest))
    left = ((f - line.evaluate(v)) / u)[out:]
    padded = np.concatenate([np.zeros(out), left])
    criteria = [
        corrected(padded, 3 + out),
        *(_criterion(c, points(v, f, u)) for c in curves.values()),
    ]
    weights = np.array([0.5, 0.25, 0.25]) * np.exp((min(criteria) - np.array(criteria)) / 2)
    weights /= weights.sum()
    lines = np.array([line.parameters[:2], *(c.parameters[:2] for c in curves.values())])
    apart = lines - found
    within = sum(
        w * fit.covariance[:2, :2] for w, fit in zip(weights, [line, *curves.values()], strict=True)
    )
    assert_allclose(covariance, within + (apart * weights[:, None]).T @ apart, rtol=1e-9)


def test_the_fit_states_the_line_and_the_uncertainty_of_both():
    rng = np.random.default_rng(6)
    v = np.geomspace(0.4, 30, 9)
    stated = rng.uniform(2e-5, 6e-5, 9)
    f = stribeck(v, 2.9e-3, 0.5, 2.0) + 3e-5 * rng.standard_normal(9)
    at = points(v, f, np.sqrt((stated**2 + np.median(stated) ** 2) / 2))
    fit = fit_direction(v, f, stated)
    assert fit.exponent is None
    mean, covariance = _averaged(_line(at), {2.0: None, 1.0: None}, at)
    assert_allclose(fit.averaged, mean, rtol=1e-6)
    assert_allclose(fit.covariance, covariance, rtol=1e-6)
    assert fit.criterion == pytest.approx(_criterion(_line(at), at), rel=1e-9)


@pytest.mark.parametrize(("exponent", "needs"), [(2.0, 0.0), (1.0, 6.0)])
def test_the_criterion_of_a_curve_holds_the_lead_that_its_shape_needs(exponent, needs):
    v = np.geomspace(0.1, 30, 30)
    u = np.full(30, 1e-5)
    f = stribeck(v, 4e-3, 0.8, exponent) + u * np.random.default_rng(3).standard_normal(30)
    fit = fit_direction(v, f, u)
    assert fit.exponent == exponent
    assert fit.criterion == pytest.approx(_criterion(fit, points(v, f, u)) + needs, rel=1e-6)
    assert_allclose(fit.level(v), fit.evaluate(v) - fit.parameters[1] * v, rtol=1e-12)


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_uncertainties_of_a_curve_are_those_of_its_numeric_derivative(exponent):
    v = np.geomspace(0.1, 30, 30)
    u = np.full(30, 1e-5)
    f = stribeck(v, 4e-3, 0.8, exponent) + 3 * u * np.random.default_rng(4).standard_normal(30)
    fit = _stribeck(points(v, f, u), exponent)

    def model(p):
        return p[0] + p[1] * v + (p[2] - p[0]) * np.exp(-((v / p[3]) ** exponent))

    steps = 1e-6 * np.abs(fit.parameters)
    slopes = [
        (model(fit.parameters + step) - model(fit.parameters - step)) / (2 * step.max())
        for step in np.diag(steps)
    ]
    design = np.transpose(slopes) / u[:, None]
    birge = max(1.0, np.sum(((f - model(fit.parameters)) / u) ** 2) / 26)
    assert_allclose(fit.covariance, birge * np.linalg.inv(design.T @ design), rtol=1e-4)
    assert fit.dof == 26
    assert fit.static == pytest.approx((fit.parameters[2], math.sqrt(fit.covariance[2, 2])))
    assert fit.stribeck_velocity == pytest.approx(
        (fit.parameters[3], math.sqrt(fit.covariance[3, 3]))
    )


@pytest.mark.parametrize(("significant", "found"), [(2, False), (3, True)])
def test_three_speeds_must_show_the_effect(significant, found):
    """By twice their uncertainty; others at low speed are too uncertain to show it."""
    v = np.concatenate([np.geomspace(0.2, 0.8, 6), np.geomspace(3, 30, 12)])
    f = stribeck(v, 4e-3, 1.0, 2.0)
    bump = (f - 2.3e-3 - 5e-5 * v)[:6]
    u = np.full(len(v), 1e-5)
    u[:6] = bump / BUMP_SIGNIFICANCE * 1.2
    u[:significant] = 1e-5
    assert (_stribeck(points(v, f, u), 2.0) is not None) == found


@pytest.mark.parametrize(("count", "found"), [(5, False), (6, True)])
def test_a_curve_needs_six_speeds(count, found):
    v = np.concatenate([[0.2, 0.4, 0.6, 0.9], np.linspace(4, 30, count - 4)])
    u = np.full(count, 1e-7)
    assert (_stribeck(points(v, stribeck(v, 4e-3, 0.7, 2.0), u), 2.0) is not None) == found


@pytest.mark.parametrize(("velocity", "found"), [(0.125, False), (0.5, True), (11.0, False)])
def test_a_velocity_at_an_edge_of_those_that_speeds_can_show_is_none(velocity, found):
    """From a third of the lowest to a third of the highest speed."""
    v = np.geomspace(0.4, 30, 40)
    u = np.full(40, 1e-9)
    assert (_stribeck(points(v, stribeck(v, 1.0, velocity, 2.0), u), 2.0) is not None) == found


@pytest.mark.parametrize("count", [6, 7, 9])
def test_a_clear_curve_through_few_speeds_is_not_mistaken_for_structure(count):
    """Three speeds within the Stribeck effect, the others far above it."""
    v = np.array([0.8, 1.0, 1.15, 6.0, 16.0, 45.0, 7.0, 20.0, 30.0])[:count]
    u = np.full(count, 0.005)
    away = 0.5 * u * np.resize([1, -1, 1], count)
    f = 0.6 + 0.4 * np.exp(-((v / 1.3) ** 2)) + 5.8e-3 * v + away
    for fit in fit_directions(np.r_[v, -v], np.r_[f, -f], np.r_[u, u]).values():
        assert fit.exponent == 2.0
        assert fit.coulomb[0] == pytest.approx(0.6, abs=3 * fit.coulomb[1])
        assert fit.viscous[0] == pytest.approx(5.8e-3, abs=3 * fit.viscous[1])
        assert fit.static[0] == pytest.approx(1.0, abs=3 * fit.static[1])


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_peak_is_a_mean_over_normal_speeds(exponent):
    """Compared with many points; its derivative by the Stribeck velocity with differences."""
    v, s, vs = np.array([0.5, 0.8, 3.0]), np.array([0.12, 0.1, 0.0]), 0.6
    nodes, shares = np.polynomial.hermite_e.hermegauss(40)
    many = np.exp(-(np.abs((v + nodes[:, None] * s) / vs) ** exponent))
    expected = shares @ many / shares.sum()
    value, slope = peak(v, vs, exponent, s)
    assert_allclose(value, expected, rtol=3e-3)
    step = 1e-6
    ahead, behind = (peak(v, vs + side, exponent, s)[0] for side in (step, -step))
    assert_allclose(slope, (ahead - behind) / (2 * step), rtol=1e-6)
