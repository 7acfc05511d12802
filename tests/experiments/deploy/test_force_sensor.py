"""The sensor in C reads what the one in Python reads, whatever it is compiled for."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.deploy.force_sensor import sensor_header
from rigtool.experiments.force_filter.creeping import Creeping
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_model.steps import Holder
from tests.experiments.deploy.sensors import (
    COUNTS,
    HOST,
    INTERVAL,
    REACH,
    STRICT,
    WARM,
    Model,
    compiled,
    expected,
    instrument,
    motions,
    moved,
)

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")

FLOAT = "-DRIGTOOL_SENSOR_FLOAT"
RANGE = REACH.torque


def header(own=None, origin=("rig",)):
    return sensor_header(own or instrument(), 1.96, origin)


@pytest.fixture(scope="module")
def samples():
    return motions()


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensor")
    return {
        "double": compiled(folder, header(), "-O1", name="double"),
        "float": compiled(folder, header(), FLOAT, "-O1", "-Wdouble-promotion", name="float"),
    }


def read(library, samples):
    library.begin()
    return library.add(samples)


@pytest.mark.compiles
@pytest.mark.parametrize("motion", ["strokes", "free", "rest", "creeping", "swinging"])
def test_readings_are_those_of_python(libraries, samples, motion):
    wanted = expected(instrument(), samples[motion])
    found = read(libraries["double"], samples[motion])
    assert np.isfinite(wanted[:, 0]).mean() > 0.9
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * RANGE)
    seen = {State(int(state)) for state in set(wanted[:, 4])}
    moving = {State.AGAINST, State.WITH, State.REVERSED}
    assert seen >= {"rest": {State.STILL}, "creeping": {State.REVERSED}}.get(motion, moving)


@pytest.mark.compiles
def test_contacts_soon_after_one_another_are_taken_back_to_before_the_first(libraries):
    time = np.arange(round(3.6 / INTERVAL)) * INTERVAL
    pulse = 0.04 * (((time > 1.0) & (time < 1.4)) | ((time > 2.1) & (time < 2.5)))
    samples = moved(0.8 * np.sin(2.5 * time), pulse)
    wanted, found = expected(instrument(), samples), read(libraries["double"], samples)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * RANGE)


@pytest.mark.compiles
@pytest.mark.parametrize(
    ("interval", "every"), [(0.5e-3, 4), (100e-6, 1), (1e-3, 8), (0.75e-3, 6), (1.375e-3, 11)]
)
def test_loops_whose_samples_are_no_even_number_for_each_of_the_equations(
    tmp_path, samples, interval, every
):
    own = instrument(interval=interval, loop_time=interval)
    part = samples["free"][:, ::every]
    wanted, found = expected(own, part), read(compiled(tmp_path, header(own)), part)
    assert np.isfinite(wanted[:, 0]).mean() > 0.9
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * RANGE)


@pytest.mark.compiles
def test_a_motor_without_current_is_carried_and_held(libraries, samples):
    part = samples["free"][:, :24000].copy()
    part[1, 6000:] = 0.0
    part[0, 12000:16000] = part[0, 12000] - np.arange(4000) // 440  # a count in 55 ms
    part[0, 16000:] = part[0, 15999]
    wanted, found = expected(instrument(), part), read(libraries["double"], part)
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * RANGE)
    held = wanted[:, 4] == State.STILL
    plant = Model().plant(INTERVAL)
    friction = plant.torque_factor * (plant.coulomb + plant.housing_friction)
    assert held[-100:].all()
    assert (wanted[-100:, 1] > 0.999 * friction / np.sqrt(3)).all()
    slope = plant.static / plant.presliding_angle
    slope += plant.housing_friction / plant.housing_presliding_angle
    half = plant.torque_factor * slope * instrument().count / 2
    turned = wanted[1010:][wanted[1010:, 4] == State.REVERSED]
    assert len(turned) > 100
    assert (turned[:, 1] > 0.999 * half / np.sqrt(3)).all()
    crawled = wanted[1600:1980]
    crawled = crawled[crawled[:, 4] == State.REVERSED]
    assert len(crawled) > 50
    assert (crawled[:, 1] > 0.999 * friction / 2 / np.sqrt(3)).all()


@pytest.mark.parametrize("motion", ["strokes", "free", "rest", "creeping", "swinging"])
def test_floats_are_off_by_less_than_a_twentieth_of_u(libraries, samples, motion):
    wanted = read(libraries["double"], samples[motion])
    found = read(libraries["float"], samples[motion])
    same = found[:, 4] == wanted[:, 4]
    assert same.mean() > 0.999
    off = np.abs(found - wanted)[same & (wanted[:, 4] > 0)]
    u = wanted[same & (wanted[:, 4] > 0), 1]
    assert (off[:, 0] < 0.05 * u).all()
    assert np.sqrt(np.mean(off[:, 0] ** 2)) < 1e-4 * RANGE
    assert (off[:, 1] < 0.02 * u).all()


def test_floats_raise_the_noise_for_as_many_steps_as_doubles(libraries):
    """A force that swings for long raises it for 0.6 s: rounding decides no step of them."""
    time = np.arange(round(6.0 / INTERVAL)) * INTERVAL
    swings = np.where(time < 4.1, 15e-3 * np.sin(2 * np.pi * 5.0 * time), 0.0)
    samples = moved(0.8 * np.sin(2.5 * time), swings)
    wanted, found = (read(libraries[name], samples) for name in ("double", "float"))
    known = wanted[:, 4] > 0
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    np.testing.assert_allclose(found[known, 1], wanted[known, 1], rtol=5e-3)


def test_blocks_and_begins_change_nothing(libraries, samples):
    library, part = libraries["double"], samples["free"][:, :9001]
    whole = read(library, part)
    library.begin()
    pieces = [library.add(piece) for piece in np.array_split(part, 7, axis=1)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)


def test_what_is_no_number_begins_anew_and_forgets_no_ripple(libraries, samples):
    library, part = libraries["double"], samples["free"][:, 16000:24000]
    before = samples["strokes"][:, :9000]
    held = np.tile(before[:, -1:], 8)
    wanted = expected(instrument(), part, np.hstack([before, held]))
    alone = expected(instrument(), part)
    assert np.nanmax(np.abs(wanted - alone)[:, 0]) > 1e-5
    for bad in ((np.nan, WARM), (np.inf, WARM), (0.1, np.nan)):
        read(library, before)
        library.add(np.vstack([held[0], np.tile(bad, (8, 1)).T]))
        assert not len(library.add(np.array([[held[0, 0], *bad]]).T))
        found = library.add(part)
        np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
        np.testing.assert_allclose(found[:, :4], wanted[:, :4], atol=1e-9 * RANGE)


def test_a_current_that_is_missing_holds(libraries, samples):
    library, part = libraries["double"], samples["free"][:, 12000:24000].copy()
    whole = read(library, part)
    part[1, 500::400] = part[2, 703] = np.nan
    part[1, 6001:6008] = -np.inf
    held = part.copy()
    held[1:] = Holder(INTERVAL).add(part[1:].copy())
    found, wanted = read(library, part), expected(instrument(), held)
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    np.testing.assert_allclose(found[:, :4], wanted[:, :4], atol=1e-9 * RANGE)
    known = whole[:, 4] > 0
    assert known.sum() > 1000
    assert (np.abs(found - whole)[known, 0] < whole[known, 1]).all()


@pytest.mark.parametrize("kind", ["double", "float"])
@pytest.mark.parametrize("counts", [700, -(2**16), 2**31 - 1])
def test_counts_that_leap_while_the_rotor_moves_are_put_back(libraries, samples, kind, counts):
    library, whole = libraries[kind], samples["strokes"]
    plain, part = read(library, whole), whole.copy()
    part[0, 11000:24000] += counts
    part[0] = (part[0] + 2**31) % 2**32 - 2**31
    found = read(library, part)
    same = found[:, 4] == plain[:, 4]
    assert same.mean() > 0.98
    known = same & (plain[:, 4] > 0)
    assert (np.abs(found - plain)[known, 0] < plain[known, 1]).all()


LEAPS = {
    "one": [(11000, 30)],
    "to and fro": [(11000, 300), (11001, 0), (14003, -90), (14011, 0)],
    "one behind the other": [(11000, 300), (11001, 900), (11002, 1500)],
    "a motion": [(11000, 8)],
    "a turn, and more": [(11000, 4000), (13000, 2**15), (15000, 2**20)],
    "at the begin": [(1, 300), (2, 700), (3, 40)],
}


@pytest.mark.parametrize("leaps", LEAPS.values(), ids=LEAPS)
def test_counts_that_leap_are_taken_as_in_python(libraries, samples, leaps):
    part = samples["strokes"].copy()
    for at, counts in leaps:
        part[0, at:] = samples["strokes"][0, at:] + counts
    found = read(libraries["double"], part)
    part[0] = instrument().counts().add(part[0])
    np.testing.assert_allclose(found, expected(instrument(), part), rtol=0, atol=1e-9 * RANGE)


def test_a_motion_beyond_five_times_the_learned_speed_is_no_leap(tmp_path):
    """The rotor is where its encoder shows it: what follows is read at its true angles."""
    own, time = instrument(reach=replace(REACH, speed=0.6)), INTERVAL * np.arange(16000)
    fast = moved(0.55 * (1 - np.cos(2 * np.pi * 4 * time)), np.zeros(len(time)))
    assert np.abs(np.diff(fast[0, ::8])).max() > 1.5 * 5 * 1.1 * 0.6 * 1e-3 / own.count
    found = read(compiled(tmp_path, header(own)), fast)
    wanted = expected(own, fast)
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * RANGE)


@pytest.mark.parametrize(
    ("rest", "leap"),
    [(159, 300), (160, 300), (161, 300), (2000, 300), (2000, 4000), (2000, -(2**16))],
)
def test_counts_that_leap_after_a_rest_begin_anew(libraries, samples, rest, leap):
    """Unless the counter wraps."""
    at, part = 8000 + rest, samples["strokes"][:, :24000].copy()
    anew = rest > 160 and leap == 300
    part[0, 8000:at] = part[0, 8000] + 1  # stopped, or at rest
    part[0, at:] = part[0, 8000] + leap
    size = len(read(libraries["double"], part[:, :at]))
    behind = read(libraries["double"], part)[size:]
    counts = instrument().counts()
    part[0] = counts.add(part[0])
    assert list(counts.shown) == [at] * anew
    own = (part[:, at:], part[:, :at]) if anew else (part,)
    wanted = expected(instrument(), *own)[-len(behind) :]
    np.testing.assert_allclose(behind, wanted, rtol=0, atol=1e-9 * RANGE)
    assert np.isnan(behind[:90, 0]).all() == anew


def test_behind_missing_samples_the_sensor_begins_anew_and_forgets_no_ripple(libraries, samples):
    library, before, part = libraries["double"], *np.split(samples["free"], [15997], axis=1)
    read(library, before)
    library.gap()
    found, wanted = library.add(part), expected(instrument(), part, before)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * RANGE)


def test_counts_that_leap_while_the_rotor_is_at_an_edge_are_put_back(libraries, samples):
    """It counts to and fro: no channel has stopped."""
    whole = samples["strokes"][:, :16000].copy()
    whole[0, 8000:] = whole[0, 8000] + np.arange(8000) // 40 % 2
    part = whole.copy()
    part[0, 12020:] += 700  # while no count passes
    plain, found = read(libraries["double"], whole), read(libraries["double"], part)
    same = found[:, 4] == plain[:, 4]
    assert same.mean() > 0.98
    known = same & (plain[:, 4] > 0)
    assert (np.abs(found - plain)[known, 0] < plain[known, 1]).all()


@pytest.mark.parametrize("degc", [1000.0, -1e30])
def test_a_temperature_that_no_motor_has_begins_anew(libraries, samples, degc):
    part = samples["free"].copy()
    part[2, 12000:16000] = degc
    plain, found = read(libraries["double"], samples["free"]), read(libraries["double"], part)
    assert len(plain) - len(found) == pytest.approx(500, abs=3)
    behind, plain = found[-1900:], plain[-1900:]
    known = (behind[:, 4] > 0) & (plain[:, 4] > 0)
    assert known.mean() > 0.85
    assert (np.abs(behind - plain)[known, 0] < 3 * behind[known, 1]).mean() > 0.99
    wanted = expected(instrument(), part)[-1900:]  # in Python it is limited
    both = known & (wanted[:, 4] > 0)
    assert (np.abs(behind - wanted)[both, 0] < 3 * wanted[both, 1]).mean() > 0.99


def test_limits_have_no_value(libraries, samples):
    changed = {
        "warm": np.where(np.arange(samples["free"].shape[1]) > 20000, 60.0, WARM),
        "cold": np.full(samples["free"].shape[1], 10.0),
    }
    for row in changed.values():
        part = samples["free"].copy()
        part[2] = row
        wanted = expected(instrument(), part)
        found = read(libraries["double"], part)
        np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
        assert (wanted[:, 4] == State.OUTSIDE).any()
        assert np.isnan(found[found[:, 4] == State.OUTSIDE, :4]).all()


def test_a_current_at_its_limit_has_no_value(tmp_path, samples):
    limit = float(np.quantile(np.abs(samples["free"][1]), 0.98))
    own = instrument(current_limit=limit)
    found = read(compiled(tmp_path, header(own)), samples["free"])
    wanted = expected(own, samples["free"])
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    assert 0.05 < np.mean(wanted[:, 4] == State.OUTSIDE) < 0.9


@pytest.mark.parametrize(
    ("current", "first", "length"), [(-10.0, 18000, 800), (10.0, 12000, 2400)], ids=str
)
def test_a_current_that_would_turn_the_output_far_within_a_step_leaves_what_python_leaves(
    libraries, samples, current, first, length
):
    """The angle that is expected is tens of deviations outside the count."""
    part = samples["free"].copy()
    part[1, first : first + length] = current  # while the encoder shows another motion
    found, wanted = read(libraries["double"], part), expected(instrument(), part)
    np.testing.assert_array_equal(found[:, 4], wanted[:, 4])
    ended = (first + length) // 8
    assert (wanted[ended : ended + 150, 4] > 0).sum() > 40
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * RANGE)


@pytest.mark.parametrize("kind", [(), (FLOAT,)])
def test_sanitizers_find_nothing(tmp_path, samples, kind):
    (tmp_path / "sensor.h").write_text(header())
    build = ["cc", *STRICT, *kind, "-g", "-fsanitize=address,undefined,float-cast-overflow"]
    build += ["-fno-sanitize-recover=all", f"-I{tmp_path}", HOST, "-o", tmp_path / "host", "-lm"]
    subprocess.run(build, check=True, timeout=120)
    part = np.concatenate([samples["free"][:, :12000], extremes()], axis=1)
    done = subprocess.run(
        [tmp_path / "host"], input=part.T.tobytes(), capture_output=True, check=True, timeout=120
    )
    found = np.frombuffer(done.stdout).reshape(-1, 5)
    assert len(found) > 1400
    assert not done.stderr


def extremes():
    """Return samples that no rig gives: counts from end to end, and currents beyond any."""
    rng = np.random.default_rng(3)
    count = 1200
    encoder = rng.choice([-(2.0**31), 2.0**31 - 1, 0.0, 5.0], count)
    current = rng.choice([0.0, 1e30, -1e30, 3.0, np.nan], count, p=[0.4, 0.1, 0.1, 0.39, 0.01])
    return np.stack([encoder, current, np.full(count, WARM)])


def test_no_text_of_a_run_is_anything_but_a_comment(tmp_path, samples):
    hostile = (
        "rig */ #error broken /*",
        "ends in a trigraph ??/",
        "ends in a backslash \\",
        "*/\nint main(void) { return 1; }\n/*",
        '" #include "/etc/passwd',
        "@DATA@ @HEAD@",
        "\u202eright to left \x1b[31m",
    )
    text = header(origin=hostile)
    library = compiled(tmp_path, text)
    part = samples["rest"][:, :4000]
    np.testing.assert_array_equal(
        read(library, part), read(compiled(tmp_path, header(), name="b"), part)
    )
    head = text[: text.index("#ifndef RIGTOOL_SENSOR_H")]
    assert head.count("*/") == 1
    assert head.rstrip().endswith("*/")


def test_states_and_counts_are_those_of_the_model():
    text = header()
    states = re.search(r"enum rigtool_sensor_state \{(.*?)\};", text, re.S)[1]
    names = re.findall(r"RIGTOOL_SENSOR_(\w+)", states)
    assert names == [state.name for state in State]
    assert f".turn = {COUNTS}," in text
    assert "@" not in text


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"interval": 1.5e-3}, "a loop of 666.7 Hz come from later ones, above 667 Hz"),
        ({"torque_constant": (float("nan"), 0.0)}, "constant is nan"),
        ({"current_limit": float("inf")}, "current_limit is inf"),
    ],
)
def test_what_a_sensor_cannot_be_made_of_is_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        header(instrument(**changed))


def test_an_output_without_inertia_is_refused():
    class Other(Model):
        def plant(self, sample_time):
            return replace(super().plant(sample_time), grasper_inertia=0.0)

    with pytest.raises(ValueError, match="the equations in C need one"):
        header(instrument(model=Other()))


UNBENT = """
#include "sensor.h"
void unbent(int steps, const int32_t *encoder, const double *bristle, double *found)
{
    struct rigtool_sensor s;
    int k;
    memset(&s, 0, sizeof s);
    s.side = 1;
    s.rested = -1;
    for (k = 0; k < steps; k++) {
        s.encoder = encoder[k];
        s.x[RS_HOUSING] = bristle[k];
        found[k] = rs_unbent(&s, 0);
    }
}
"""


def test_what_a_bristle_lacks_while_it_creeps_is_that_of_python(tmp_path):
    """Turns after which the rotor creeps on for two seconds, with a bristle that is bent anew."""
    own, random = instrument(), np.random.default_rng(4)
    ends = random.uniform(0.2, 0.9, 60) * (-1) ** np.arange(60)
    bristle = np.concatenate(
        [
            [0.0],
            *(
                np.r_[np.linspace(first, last, 300), np.full(1700, last)]
                for first, last in zip(np.r_[0.0, ends[:-1]], ends, strict=True)
            ),
        ]
    )
    encoder = np.floor(np.cumsum(0.02 * np.sign(bristle))).astype(np.int32)
    (tmp_path / "sensor.h").write_text(header(own))
    (tmp_path / "unbent.c").write_text(UNBENT)
    library = tmp_path / "unbent.so"
    build = ["cc", "-std=c99", "-shared", "-fPIC", tmp_path / "unbent.c", "-o", library, "-lm"]
    subprocess.run(build, check=True, timeout=120)
    found = np.empty(len(bristle))
    pointers = (each.ctypes.data_as(ctypes.c_void_p) for each in (encoder, bristle, found))
    ctypes.CDLL(str(library)).unbent(len(bristle), *pointers)
    plant, step_time = own.model.plant(own.grid.sample_time), own.grid.step_time
    creeping = Creeping(own.count, plant.housing_presliding_angle, step_time)
    still = np.zeros(len(bristle), dtype=bool)
    wanted = creeping.add(own.count * encoder, bristle, still)
    assert 0.05 < np.mean(wanted > 0) < 0.95
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
