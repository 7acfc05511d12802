"""A row of the torque against the equations of its filters, written with vectors and densities."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal, norm

from rigtool.experiments.force_model.model import ROTOR_ORDERS
from rigtool.experiments.force_sensor.power_up import mixed_ripple
from rigtool.experiments.force_sensor.power_up import ripple_rows as rows
from rigtool.experiments.force_sensor.power_up.lasting_contact import (
    DRIFT,
    LEAST_LASTS,
    counted,
    lasts_too,
    normal,
    weighed,
)
from rigtool.experiments.force_sensor.power_up.shown_ripple import (
    LARGEST_SHOWN,
    show,
    turned_inertia,
)

COUNT, PARTS = mixed_ripple.WAVE_COUNT, mixed_ripple.PARTS
M = COUNT  # what a stroke deviates by
SIZE, TIME = 0.4e-3, 0.019
MOST = rows.ENDS * TIME
UNIT = math.log(2 * math.pi) / 2  # that the likelihoods of the module leave out


def drawn(seed, slides=True):
    """Return state and parameters in the middle of a recording, in which a row is full."""
    rng = np.random.default_rng(seed)
    state, parameters = np.zeros(1, mixed_ripple.STATE), np.zeros(1, mixed_ripple.PARAMETERS)
    s, p = state[0], parameters[0]
    for name, value in {"steps": 20, "time": TIME, "size": SIZE, "late": 25}.items():
        p[name] = value
    for name in ("covariance", "covariances"):
        root = SIZE * rng.standard_normal((*s[name].shape[:-1], 3 * PARTS)) / 4
        s[name] = root @ np.swapaxes(root, -1, -2)
    for name in ("mean", "means", "expected", "level"):
        s[name] = SIZE * rng.standard_normal(s[name].shape)
    s["drawn"] = SIZE**2 * rng.uniform(2, 3, (2, COUNT))  # far from the largest ripple
    for name in ("shift", "shifts"):
        s[name] = 0.1 * rng.standard_normal(s[name].shape)
    s["lasting"][:, 0] = SIZE * rng.standard_normal(2)
    s["lasting"][:, 1] = SIZE**2 * rng.uniform(1, 2, 2)
    s["lastings"] = SIZE * rng.uniform(1, 2, s["lastings"].shape)
    s["level_variance"] = SIZE**2 * rng.uniform(1, 30, 2)
    s["other"], s["proven"] = rng.standard_normal(2)
    for name in ("touched", "fast", "lasts", "hangs"):
        s[name] = rng.uniform(0.1, 0.6, s[name].shape)
    s["row"] = rng.uniform(-1, 1, PARTS)
    s["row"][M] = SIZE * rng.standard_normal()
    p["hanging"] = SIZE**2 * rng.uniform(1, 2, PARTS - COUNT - 1)
    s["length"], s["filled"], s["slid"] = 17, 17, 17 if slides else 16
    s["since"], s["doubted"], s["drawn_length"] = 3, rng.integers(4 * COUNT), rng.integers(1024)
    return state, parameters


def density(error, variance):
    return norm.logpdf(error, scale=math.sqrt(variance)) + UNIT


def mixed(probability, one, other):
    """Return the logarithm of a mixture's likelihood, and the probability of the other."""
    logs = math.log(1 - probability) + one, math.log(probability) + other
    return np.logaddexp(*logs), math.exp(logs[1] - np.logaddexp(*logs))


def after_time(s, slides):
    """Return by name what goes on by itself until the end of a row."""
    found = {name: np.copy(s[name]) for name in s.dtype.names}
    transition = np.eye(PARTS)
    transition[M, M] = kept = math.exp(-TIME / rows.MEMORY) if slides else 0.0
    for name in ("mean", "shift"):
        found[name] = s[name] @ transition
    found["covariance"] = transition @ s["covariance"] @ transition
    found["covariance"][:, M, M] += (1 - kept**2) * SIZE**2
    begun, ended = (1 - s["touched"]) * rows.BEGINS * TIME, s["touched"] * rows.ENDS * TIME
    found["touched"] = s["touched"] + begun - ended
    half = rows.CHANGES * TIME / 2  # a walk that changes becomes either with equal probability
    found["fast"] = s["fast"] * (1 - half) + (1 - s["fast"]) * half
    walks = (np.array(rows.WALKS) * SIZE) ** 2 * TIME
    turned = 0.0 if slides else (rows.AFTER_REVERSAL * SIZE) ** 2 * TIME / rows.ROW_TIME
    found["level_variance"] = s["level_variance"] + walks + turned
    if slides:
        found["lasting"] = s["lasting"] + [0, (DRIFT * SIZE) ** 2 * TIME]
        # each wave of each filter in turn
        one, f = divmod(int(s["doubted"]), 4)
        grown = 4 * COUNT * s["drawn"][f % 2, one] * TIME / rows.FORGOTTEN
        found["covariance"][f, one, one] += grown
        found["doubted"] = (s["doubted"] + 1) % (4 * COUNT)
    return found


def read(s):
    """Return by name what a row that slides leaves."""
    found = after_time(s, True)
    noise, value = (rows.NOISE * SIZE) ** 2, s["row"][M]
    # where something touches: two walks, of which either may leap
    anew, likely = (rows.CONTACT * SIZE) ** 2, []
    for i in range(2):
        level, variance = found["level"][i], found["level_variance"][i]
        stays = density(value - level, variance + noise)
        leaps = density(value, anew + noise) + math.log(rows.CHANGES * TIME)
        if leaps > stays:
            level, variance = 0.0, anew
        likely.append(max(leaps, stays))
        gain = variance / (variance + noise)
        found["level"][i] = level + gain * (value - level)
        found["level_variance"][i] = (1 - gain) * variance
    touching, found["fast"] = mixed(found["fast"], *likely)
    evidence, seen = [], np.array(s["row"])
    seen[M] = 1.0
    for f in range(4):
        mean, covariance = found["mean"][f].copy(), found["covariance"][f].copy()
        error, variance = value - seen @ mean, seen @ covariance @ seen + noise
        before = found["touched"][f]
        alone, touched = mixed(before, density(error, variance), touching)
        evidence.append(mixed_ripple.ROW_EVIDENCE * alone)
        found["touched"][f] = touched
        gain = (1 - touched) * covariance @ seen / variance
        found["mean"][f] = mean + gain * error
        found["covariance"][f] = covariance - np.outer(gain, seen @ covariance)
        if f > 1:  # a load hangs
            continue
        shift, lasting = found["shift"][f].copy(), found["lasting"][f].copy()
        own = 1 + seen @ shift
        whole = variance + own**2 * lasting[1]
        lasts, _ = mixed(before, density(error - own * lasting[0], whole), touching)
        evidence[f], found["lasts"][f] = mixed(
            found["lasts"][f], evidence[f], mixed_ripple.ROW_EVIDENCE * lasts
        )
        part = (1 - touched) * own * lasting[1] / whole
        found["lasting"][f] = [
            lasting[0] + part * (error - own * lasting[0]),
            lasting[1] * (1 - part * own),
        ]
        found["shift"][f] = shift - gain * own
    for h in range(2):
        evidence[h], found["hangs"][h] = mixed(found["hangs"][h], evidence[h], evidence[h + 2])
    found["other"] = s["other"] + evidence[1] - evidence[0]
    found["proven"] = s["proven"] + np.clip(found["other"] - s["proven"], -MOST, MOST)
    return found


def together(found):
    """Return by name what the hypotheses are together: moments of a mixture of normals, each with
    a load that hangs and without, then with and without a contact that lasts."""
    lasts, hangs, lasting = found["lasts"], found["hangs"], found["lasting"]
    shift, mean = found["shift"][:, :COUNT], found["mean"][:, :COUNT]
    covariance = found["covariance"][:, :COUNT, :COUNT]
    own = mean.copy()
    own[:2] += (lasts * lasting[:, 0])[:, None] * shift
    normals = [multivariate_normal(np.zeros(COUNT), np.diag(found["drawn"][0]))]
    normals += [multivariate_normal(own[f], covariance[f]) for f in (0, 2)]
    unchanged, *near = (normal.logpdf(np.zeros(COUNT)) for normal in normals)
    ratio = mixed_ripple.ROW_EVIDENCE * (np.array(near) - unchanged)
    ratio = np.exp(np.clip(ratio, -mixed_ripple.MAX_LOG_RATIO, mixed_ripple.MAX_LOG_RATIO))
    same = mixed_ripple.SAME * ((1 - hangs[0]) * ratio[0] + hangs[0] * ratio[1])
    odds = np.array([same, 1 - mixed_ripple.SAME, np.exp(found["other"])])
    same, *weights = odds / odds.sum()
    counts = np.array([weights[0], max(min(4 * weights[1] ** 2, 1.0), weights[1])])
    parts = [(same, 1.0, np.zeros(COUNT), np.zeros((COUNT, COUNT)))]
    for h in range(2):
        by, more = np.outer(shift[h], shift[h]) * lasting[h, 1], counts[h] / weights[h]
        left = weights[h] * (1 - hangs[h])
        parts.append((left * (1 - lasts[h]), more, mean[h], covariance[h]))
        parts.append(
            (left * lasts[h], more, mean[h] + lasting[h, 0] * shift[h], covariance[h] + by)
        )
        parts.append((weights[h] * hangs[h], more, mean[h + 2], covariance[h + 2]))
    known = sum(part * m for part, _, m, _ in parts)
    # with a load that hangs or without, what the mean of the mixture is off by counts for each;
    # that of a contact that lasts and without is one mean
    square = sum(more * part * (c + np.outer(m - known, m - known)) for part, more, m, c in parts)
    return found | {"weights": weights, "counts": counts, "known": known, "doubt": np.tril(square)}


def begun(s, found):
    """Return what is found, with the next row begun."""
    length = (137 * s["drawn_length"] + 29) % 1024
    row = {"row": np.zeros(PARTS), "filled": 0, "slid": 0, "drawn_length": length}
    return together(found) | row | {"length": 10 + 20 * length // 1024}


KEPT = ("mean", "covariance", "shift", "lasting")


def assert_state(s, expected):
    taken_back = (*KEPT, *(name + "s" for name in KEPT), "since")
    taken_back += ("other", "proven", "known", "doubt", "weights", "counts")
    for name in s.dtype.names:
        if s["touched"].max() > rows.RECOGNISED and name in taken_back:
            continue
        assert_allclose(s[name], expected[name], rtol=1e-9, atol=1e-15, err_msg=name)


@pytest.mark.parametrize("seed", range(6))
def test_a_row_is_read_as_its_equations_have_it(seed):
    state, parameters = drawn(seed)
    if seed % 2:
        state["row"][0, M] *= 20  # a leap, where something touches
    expected = begun(state[0], read(state[0]) | {"since": 4})
    rows.read_row(state[0], parameters[0])
    assert_state(state[0], expected)


def test_orders_that_were_not_learned_show_no_change():
    state, _ = drawn(2)
    s = state[0]
    mixed_ripple.mix(s)
    without = s["weights"].copy()
    for name in ("mean", "shift", "drawn", "covariance"):
        s[name][..., 4:6] = 0.0
    s["covariance"][:, 4:6], s["hangs"] = 0.0, 0.0
    kept = [i for i in range(COUNT) if i not in (4, 5)]
    own = multivariate_normal(
        (s["mean"][0] + s["lasts"][0] * s["lasting"][0, 0] * s["shift"][0])[kept],
        s["covariance"][0][np.ix_(kept, kept)],
    )
    ratio = own.logpdf(np.zeros(len(kept)))
    ratio -= multivariate_normal(np.zeros(len(kept)), np.diag(s["drawn"][0, kept])).logpdf(
        0 * own.mean
    )
    mixed_ripple.mix(s)
    odds = s["weights"] / (1 - s["weights"].sum())
    assert odds[0] == pytest.approx(
        (1 - mixed_ripple.SAME) / mixed_ripple.SAME / math.exp(mixed_ripple.ROW_EVIDENCE * ratio)
    )
    assert not np.allclose(s["weights"], without)


def test_no_change_is_likelier_by_the_largest_ratio_at_most():
    """Where rows have shown that nothing has changed: the other hypothesis may be as likely."""
    s = drawn(2)[0][0]
    s["covariance"], s["mean"], s["lasting"] = SIZE**2 * 1e-8 * np.eye(PARTS), 0.0, 0.0
    s["other"] = mixed_ripple.MAX_LOG_RATIO
    mixed_ripple.mix(s)
    assert s["weights"][1] == pytest.approx(1 / (1 + mixed_ripple.SAME))


def test_variances_that_rounding_takes_below_zero_leave_weights():
    s = drawn(2)[0][0]
    way = np.append(SIZE * np.linspace(0.3, 1.1, COUNT), np.zeros(PARTS - COUNT))
    s["covariance"] = (1 - 1e-15) * np.outer(way, way)
    s["covariance"][:, 0, 0] = way[0] ** 2
    mixed_ripple.mix(s)
    assert np.isfinite(s["weights"]).all()
    assert np.isfinite(s["doubt"]).all()


def test_orders_that_are_not_followed_lag_by_their_frequency():
    """Squares of first-order lags at the speed, of each of the sums."""
    state, parameters = drawn(0)
    p, square = parameters[0], np.random.default_rng(0).uniform(1, 2, (len(ROTOR_ORDERS), 4))
    p["lag_time"], p["unfollowed"] = 0.05, square
    rows.renew_unfollowed(state[0], p, -3.0)
    gain = np.abs(1 / (1 + 1j * np.array(ROTOR_ORDERS) * -3.0 * 0.05))
    assert_allclose(state[0]["unfollowed"], gain**2 @ square)


def test_a_row_in_which_the_motion_turns_back_is_not_read():
    state, parameters = drawn(1, slides=False)
    expected = begun(state[0], after_time(state[0], False))
    rows.read_row(state[0], parameters[0])
    assert_state(state[0], expected)


@pytest.mark.parametrize("hung", [0, 2])
@pytest.mark.parametrize("times", [0.99, 1.01])
def test_an_order_beyond_three_times_what_a_power_up_draws_begins_anew(times, hung):
    """Each order has the sum of both of its variances; evidence goes with the likelier filter."""
    state, parameters = drawn(0)
    s, order, waves = state[0], 2 * (COUNT // 2 - 1), slice(COUNT)
    s["covariance"] = 1e-9 * np.diag(s["drawn"][0, 0] * np.ones(PARTS))  # a row changes no mean
    limit = rows.LARGEST_RIPPLE_RATIO * math.sqrt(s["drawn"][1, order : order + 2].sum())
    s["mean"], s["mean"][:, waves] = 0.0, np.tile(s["expected"], (2, 1))
    s["mean"][hung : hung + 2, order : order + 2] += times * limit * np.array([0.6, -0.8])
    s["row"][M], s["lasts"] = s["row"][waves] @ s["mean"][hung + 1, waves], 0.0
    s["other"], s["proven"], s["hangs"] = 300.0, 5.0, 0.999 if hung else 0.001
    for name in ("mean", "covariance"):  # a filter that sees a contact goes back to the same
        s[name + "s"] = s[name][:, None]
    kept = s["mean"].copy()
    rows.read_row(s, parameters[0])
    one = hung + 1
    for f in {0, 1, 2, 3} - ({one} if times > 1 else set()):  # the other ones stay
        assert_allclose(s["mean"][f, waves], kept[f, waves], rtol=1e-4)
    if times < 1:
        return
    assert s["other"] == 0.0
    assert s["proven"] == 0.0
    assert_allclose(s["mean"][one, waves], s["expected"][1])
    own = [*s["drawn"][1], s["covariance"][one, M, M], *(parameters["hanging"][0] * (hung > 0))]
    assert_allclose(s["covariance"][one], np.diag(own))
    assert s["covariance"][one, M, M] > 0
    assert not s["mean"][one, M + 1 :].any()
    for name in KEPT[: 2 if hung else 4]:
        assert_allclose(s[name + "s"][one], [s[name][one]] * 2)
    assert hung or not s["shift"][1, waves].any()


@pytest.mark.parametrize("one", [1, 3])
def test_a_filter_that_begins_anew_leaves_the_evidence_of_the_likelier_one(one):
    state, parameters = drawn(0)
    s = state[0]
    s["covariance"] = 1e-9 * np.diag(s["drawn"][0, 0] * np.ones(PARTS))
    s["mean"], s["mean"][one, 0] = 0.0, 10 * SIZE
    s["row"][:], s["other"], s["proven"] = 0.0, 30.0, 29.0
    s["hangs"] = 0.001 if one == 3 else 0.999
    rows.read_row(s, parameters[0])
    assert_allclose(s["mean"][one, :COUNT], s["expected"][1])
    assert s["other"] > 20
    assert s["proven"] > 28


def test_odds_stay_within_the_largest_ratio():
    for sign in (1.0, -1.0):
        state, parameters = drawn(3)
        state["other"] = sign * (mixed_ripple.MAX_LOG_RATIO + 20)
        rows.read_row(state[0], parameters[0])
        assert state["other"][0] == sign * mixed_ripple.MAX_LOG_RATIO


@pytest.mark.parametrize("other", [-20.0, 20.0])
def test_evidence_that_stays_grows_as_a_contact_may_have_lasted(other):
    state, parameters = drawn(3)
    s = state[0]
    s["other"], s["proven"] = other, 0.0
    rows.read_row(s, parameters[0])
    assert s["touched"].max() < rows.RECOGNISED
    assert abs(s["other"]) > 10
    assert s["proven"] == pytest.approx(math.copysign(rows.ENDS * TIME, other))


def test_what_was_known_before_a_recognised_contact_comes_back():
    state, parameters = drawn(4)
    s = state[0]
    s["row"][M] = 60 * SIZE
    before = {name: s[name + "s"].copy() for name in KEPT}
    proven = s["proven"].copy()
    rows.read_row(s, parameters[0])
    assert s["touched"].min() > rows.RECOGNISED
    assert s["other"] == s["proven"] == proven
    assert not s["since"].any()
    left = [i for i in range(PARTS) if i != M]  # what strokes deviate by is drawn anew
    for name in KEPT:
        own = (..., *np.ix_(left, left)) if name == "covariance" else (..., left)
        own = ... if name == "lasting" else own
        for again in (s[name], s[name + "s"][:, 1]):
            assert_allclose(again[own], before[name][:, 0][own], err_msg=name)
        assert_allclose(s[name + "s"][:, 0], before[name][:, 0])
    assert not s["mean"][:, M].any()
    assert not s["shift"][:, M].any()
    assert_allclose(s["covariance"][:, M], [SIZE**2 * np.eye(PARTS)[M]] * 4)
    assert_allclose(s["covariance"][..., M], s["covariance"][:, M])


@pytest.mark.parametrize(("since", "moved"), [(23, False), (24, True)])
def test_what_is_known_is_kept_every_so_many_rows(since, moved):
    state, parameters = drawn(5)
    s = state[0]
    s["since"] = since
    before = {name: s[name + "s"].copy() for name in KEPT}
    rows.read_row(s, parameters[0])
    assert s["touched"].max() < rows.RECOGNISED
    assert_allclose(s["since"], 0 if moved else since + 1)
    for name in KEPT:
        now = np.stack([before[name][:, 1], s[name]], axis=1) if moved else before[name]
        assert_allclose(s[name + "s"], now, err_msg=name)


@pytest.mark.parametrize("f", [0, 2])
@pytest.mark.parametrize(("untouched", "counts"), [(0.9e-6, False), (1.1e-6, True)])
def test_a_row_that_is_surely_touched_leaves_the_ripple_alone(f, untouched, counts):
    state, parameters = drawn(0)
    s, p = state[0], parameters[0]
    before, shift = s["mean"].copy(), s["shift"].copy()
    mean, covariance, seen = s["mean"][f], s["covariance"][f], np.array(s["row"])
    value, seen[M] = seen[M], 1.0
    alone = density(value - seen @ mean, seen @ covariance @ seen + (rows.NOISE * SIZE) ** 2)
    odds = s["touched"][f] / (1 - s["touched"][f]) * untouched
    rows._by_ripple(s, p, f, alone - math.log(odds))
    assert 1 - s["touched"][f] == pytest.approx(untouched, rel=1e-5)
    changed = np.array_equal(s["mean"], before), np.array_equal(s["shift"], shift)
    assert changed == (not counts, not (counts and f < 2))


@pytest.mark.parametrize(("f", "h"), [(0, 0), (1, 1), (2, 0), (3, 1)])
@pytest.mark.parametrize("likelier", [True, False])
def test_a_contact_is_recognised_where_both_hypotheses_see_it(f, h, likelier):
    """Each by its filters with and without a load that hangs, of which one explains the row."""
    state, parameters = drawn(4)
    s = state[0]
    s["row"][M], s["mean"][f, M], s["other"], s["proven"] = 60 * SIZE, 60 * SIZE, 30.0, 0.0
    s["hangs"][h] = 1 - 1e-5 if likelier == (f > 1) else 1e-5
    rows.read_row(s, parameters[0])
    sees = s["touched"] > rows.RECOGNISED
    assert_allclose(sees, np.arange(4) != f)
    assert s["proven"] == pytest.approx(MOST if likelier else 0.0)
    assert (s["other"] == 0) != likelier


@pytest.mark.parametrize(
    ("step_time", "steps", "late"), [(1e-3, 20, 25), (8e-3, 2, 31), (0.1, 1, 5)]
)
def test_rows_have_20_ms_and_half_a_second_is_taken_back(step_time, steps, late):
    assert (rows.row_steps(step_time), rows.late_rows(step_time)) == (steps, late)


# -- a contact that lasts


@pytest.mark.parametrize("probability", [0.01, 0.3, 0.8])
@pytest.mark.parametrize("logs", [(0.3, -1.2), (-800.0, -801.0), (700.0, 720.0)])
def test_two_likelihoods_are_mixed_by_their_probability(probability, logs):
    assert_allclose(weighed(probability, *logs), mixed(probability, *logs))


@pytest.mark.parametrize(("other", "expected"), [(-60.0, LEAST_LASTS), (60.0, 1 - LEAST_LASTS)])
def test_what_counts_keeps_away_from_0_and_1(other, expected):
    together, lasts = counted(0.5, 0.0, other)
    assert lasts == expected
    assert together == pytest.approx(max(other, 0.0) + math.log(0.5))


def test_a_likelihood_is_that_of_a_normal_but_for_a_constant():
    found = [normal(error, 0.3) - norm.logpdf(error, scale=0.3**0.5) for error in (0.0, -2.0, 0.7)]
    assert_allclose(found, UNIT)


@pytest.mark.parametrize("seen", [1.0, 0.4, -0.2])
def test_a_lasting_contact_is_conditioned_on_what_a_row_shows(seen):
    """Joint normal of contact and row, and what a row that may be touched shows of it."""
    mean, own, variance, error = 0.3, 0.5, 0.2, -0.4
    joint = np.array([[own, seen * own], [seen * own, seen**2 * own + variance]])
    slope = joint[0, 1] / joint[1, 1]
    for untouched in (1.0, 0.25, 0.0):
        lasting = np.array([mean, own])
        found = lasts_too(lasting, error, seen, variance, untouched)
        likely = multivariate_normal.logpdf(error, seen * mean, joint[1, 1])
        assert found == pytest.approx(likely + UNIT)
        assert lasting[0] == pytest.approx(mean + untouched * slope * (error - seen * mean))
        assert lasting[1] == pytest.approx(own - untouched * slope * joint[0, 1])


# -- waves as the filter's torque shows them

WAVES = ("angle", "speed", "housing", "sine", "cosine", "seen")


def watched(seed, output=0.7, speed=2.0, bristle=0.95, gains=1.0):
    """Return state, parameters and what the filter has, with gains of an observer that settles."""
    rng = np.random.default_rng(seed)
    state, parameters = drawn(seed)
    s, p = state[0], parameters[0]
    values = {"factor": 1.18, "step_time": 1e-3, "inertia": 2e-5, "friction": 9e-3}
    values |= {"length": 8e-3, "slow": 0.5, "shown": 0.08, "load_friction": 0.1, "onset": 1.8e-3}
    for name, value in values.items():
        p[name] = value
    for name in (*WAVES, "waves"):
        s[name] = 1e-3 * rng.standard_normal(COUNT + 1)  # the last is their sum
    s["direction"] = 1.0
    follows = gains * np.array([0.3, 30.0, 2.0, -0.05, 0.04, -4e-3])
    return s, p, np.append(follows, [output, speed, bristle])


@pytest.mark.parametrize(("speed", "bristle"), [(2.0, 0.95), (-1.5, -0.8), (-2.0, 0.3)])
def test_waves_are_shown_by_a_linear_observer(speed, bristle):
    s, p, follows = watched(0, speed=speed, bristle=bristle)
    s["direction"], torque, step = math.copysign(1.0, bristle), -3e-3, 1e-3
    before = {name: s[name].copy() for name in WAVES}
    # the bristle of length L: dz/dt = v - |v| z / L in its length, over a step
    kept = math.exp(-abs(speed) * step / p["length"])
    slope = (1 - math.copysign(bristle, speed * bristle)) * kept * step / p["length"]
    feels = 1 + p["load_friction"] * bristle * torque / math.hypot(torque, p["onset"])
    a, v, h, sine, cosine, seen = range(6)
    push = np.zeros(6)
    push[[sine, cosine]] = bristle * np.sin(0.7), bristle * np.cos(0.7)
    push[h], push[seen] = -p["friction"], feels
    change, feed = np.eye(6), np.zeros(6)
    change[h, h], change[h, v] = kept, slope
    change[v] += step / p["inertia"] * push
    feed[v] = -step / p["inertia"]
    change[a] += step * change[v]
    feed[a] = step * feed[v]
    gain = follows[:6] * [-1, -1, -1, 1, 1, 1 / p["factor"]]
    observer = np.eye(6) + np.outer(gain, np.eye(6)[a])
    expected = observer @ (
        change @ np.stack([before[name] for name in WAVES]) + np.outer(feed, s["waves"])
    )
    show(s, p, follows, torque)
    for name, value in zip(WAVES, expected, strict=True):
        assert_allclose(s[name], value, rtol=1e-9, err_msg=name)


def test_an_observer_shows_a_wave_that_stays():
    """All that turns is then in balance: the torque found, with the friction that it brings."""
    s, p, follows = watched(1, gains=1.0)
    follows[2:5] = 0.0
    for name in ("housing", "sine", "cosine"):
        s[name] = 0.0
    for _ in range(4000):
        show(s, p, follows, 5e-3)
    feels = 1 + p["load_friction"] * 0.95 * 5e-3 / math.hypot(5e-3, p["onset"])
    assert_allclose(feels * s["seen"], s["waves"] + p["friction"] * s["housing"], rtol=1e-6)


@pytest.mark.parametrize("begins", [True, False])
def test_a_stroke_that_begins_forgets_what_the_angle_showed(begins):
    s, p, follows = watched(2, speed=-2.0, bristle=-0.51 if begins else -0.49)
    sine = s["sine"].copy()
    follows[:6] = 0.0
    show(s, p, follows, 0.0)
    assert s["direction"] == (-1.0 if begins else 1.0)
    assert_allclose(s["sine"], 0.0 if begins else sine)
    assert_allclose(s["cosine"] == 0, begins)
    follows[8] = 0.9
    show(s, p, follows, 0.0)
    assert s["direction"] == 1.0


@pytest.mark.parametrize("why", ["slow", "large"])
def test_held_or_runaway_waves_follow_in_a_set_time(why):
    s, p, follows = watched(3, speed=-0.4 if why == "slow" else -0.6)
    if why == "large":
        s["seen"] = LARGEST_SHOWN * 1.2 * np.where(np.arange(COUNT + 1) % 2, 1.0, -1.0)
        follows[5] = 0.0
    expected = s["seen"] + 0.08 * (s["waves"] - s["seen"])
    show(s, p, follows, 0.0)
    assert_allclose(s["seen"], expected)
    for name in ("angle", "speed", "housing"):
        assert not s[name].any()


def test_what_turns_with_the_rotor_has_its_inertia_by_energy():
    """A torque that accelerates the rotor carries the output along: by the ratio of the angles in
    its acceleration, by that of the torques in the torque that it takes."""
    rotor, output, ratio, factor = 2e-5, 3e-4, 0.7, 1.5
    acceleration = 40.0
    carried = output * acceleration / ratio  # at the output
    own = SimpleNamespace(
        inertia=rotor, grasper_inertia=output, angle_ratio=ratio, torque_factor=factor
    )
    expected = rotor * acceleration + carried / factor
    assert turned_inertia(own) * acceleration == pytest.approx(expected, rel=1e-12)
