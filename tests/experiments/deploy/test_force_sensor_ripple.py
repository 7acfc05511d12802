"""What the sensor in C forgets of another power-up's ripple, which no motion of the tests shows."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.deploy.force_sensor import sensor_header
from rigtool.experiments.force_model.drawn_ripple import learned_ripple
from rigtool.experiments.force_sensor.power_up.lasting_contact import HANGING
from rigtool.experiments.force_sensor.power_up.mixed_ripple import PARTS, WAVE_COUNT
from rigtool.experiments.force_sensor.power_up.ripple_rows import LARGEST_RIPPLE_RATIO
from tests.experiments.deploy.sensors import STRICT, Model, instrument
from tests.experiments.force_filter.plants import PLANT, UNCERTAINTY

pytestmark = [
    pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc"),
    pytest.mark.compiles,
]

HOST = """
#include "sensor.h"
static struct rigtool_sensor s;
void anew(int filter, double *known, double *odds);
/* known (3, .): in the first row that of a filter; in all, then, that and what is kept of it.
 * odds: probability that a load hangs, other and proven. A row without waves is taken in. */
void anew(int filter, double *known, double *odds)
{
    struct rs_filter *f = &s.filters[filter];
    int k;
    rigtool_sensor_init(&s);
    for (k = 0; k < RS_FILTERS; k++) {
        s.filters[k].touched = 1e-9;
        s.filters[k].lasts = 0.1;
        s.filters[k].known.lasting[1] = rs_model.row_lasting;
        s.filters[k].before[0] = s.filters[k].before[1] = s.filters[k].known;
    }
    memcpy(&f->known, known, sizeof f->known);
    s.hangs[0] = s.hangs[1] = odds[0];
    s.other = odds[1];
    s.proven = odds[2];
    rs_take(&s);
    memcpy(known, &f->known, sizeof f->known);
    memcpy(known + sizeof f->known / sizeof *known, f->before, sizeof f->before);
    odds[1] = s.other;
    odds[2] = s.proven;
}
"""
FIRST, PAIRS = PARTS - WAVE_COUNT, PARTS * (PARTS - 1) // 2
MEAN, U, D, SHIFT, _ = np.cumsum([PARTS, PAIRS, PARTS, PARTS, 2])
SIZE = PLANT.torque_factor * (UNCERTAINTY.stroke + UNCERTAINTY.friction_noise)


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rows")
    (folder / "sensor.h").write_text(sensor_header(instrument(), 1.96, ("rig",)))
    (folder / "host.c").write_text("#include <string.h>\n" + HOST)
    library = folder / "rows.so"
    build = ["cc", *STRICT, "-shared", "-fPIC", f"-I{folder}", folder / "host.c", "-o", library]
    subprocess.run([*build, "-lm"], check=True, timeout=120)
    anew = ctypes.CDLL(str(library)).anew

    def take(filter_number, known, odds):
        every, odds = np.zeros((3, len(known))), np.array(odds)
        every[0] = known
        anew(filter_number, *(a.ctypes.data_as(ctypes.c_void_p) for a in (every, odds)))
        return every, odds

    return take


@pytest.mark.parametrize("number", [1, 3])
@pytest.mark.parametrize("hangs", [0.001, 0.999])
@pytest.mark.parametrize("times", [0.99, 1.01])
def test_an_order_beyond_the_largest_ratio_begins_anew(taken, number, hangs, times):
    own, rng = learned_ripple(Model()), np.random.default_rng(2)
    known = np.zeros(MEAN + PAIRS + 2 * PARTS + 2)
    mean, u, d, shift = np.split(known, [MEAN, U, D, SHIFT])[:4]
    last = slice(PARTS - 2, PARTS)
    mean[FIRST:], d[:] = -own.coefficient, 1e-12
    limit = LARGEST_RIPPLE_RATIO * np.sqrt(own.drawn[-2:].sum())
    mean[last] += times * limit * np.array([0.6, -0.8])
    u[:], shift[1:] = 1e-3 * rng.standard_normal(PAIRS), 0.1
    column = np.arange(1, PARTS)
    u[column * (column - 1) // 2] = 0.5  # with what a stroke deviates by
    stroke = d[0] + sum(0.25 * d[1:])
    given = known.copy()
    every, odds = taken(number, known, [hangs, 30.0, 29.0])
    found_mean, found_u, found_d, found_shift, _ = np.split(every[0], [MEAN, U, D, SHIFT])
    if times < 1:  # a row without waves hardly changes the ripple
        assert_allclose(found_mean[FIRST:], given[:MEAN][FIRST:], rtol=1e-3)
        assert found_u.any()
        return
    assert_allclose(found_mean[1:], [0, 0, 0, *-own.coefficient])
    assert not found_u.any()
    assert_allclose(found_d[0], stroke, rtol=1e-4)  # that of a stroke stays
    hanging = (np.array(HANGING) * SIZE) ** 2
    # what a filter without such a load has of it is used nowhere
    assert_allclose(found_d[1:], [*(hanging if number == 3 else found_d[1:FIRST]), *own.drawn])
    assert not found_shift[1:].any()
    assert_allclose(every[1:], [every[0]] * 2)
    likelier = (hangs > 0.5) == (number == 3)
    assert (odds[1] == 0) == likelier
    assert (odds[2] < 1) == likelier
