@HEAD@
#ifndef RIGTOOL_SENSOR_H
#define RIGTOOL_SENSOR_H

/*
 * Torque on the output from current and encoder, sample by sample; C99, no allocation, no globals.
 *
 *     struct rigtool_sensor sensor;
 *     rigtool_sensor_init(&sensor);
 *     for (;;) {
 *         struct rigtool_sensor_sample sample = {count, ampere, degc};
 *         const struct rigtool_sensor_reading *now = rigtool_sensor_update(&sensor, sample);
 *     }
 *
 * Numbers are doubles; `#define RIGTOOL_SENSOR_FLOAT` before the include makes them floats. What
 * begins with rs_ is not for use outside. Compile without -ffast-math: a reading without value is
 * NaN.
 */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef RIGTOOL_SENSOR_FLOAT
typedef float rigtool_sensor_real;
#define RS_MATH(name) name##f
#define RS_TERMS 8
#define RS_NARROWEST 5e-2f
#define RS_STRAIGHT 0.1f
#define RS_LEAST_WEIGHT 1e-7f
#else
typedef double rigtool_sensor_real;
#define RS_MATH(name) name
#define RS_TERMS 20
#define RS_NARROWEST 1e-2
#define RS_STRAIGHT 1e-2
#define RS_LEAST_WEIGHT 1e-15
#endif
typedef rigtool_sensor_real rs_real;
#if defined(__GNUC__) && !defined(__clang__)
#define RS_UNROLL _Pragma("GCC unroll 16")
#else
#define RS_UNROLL
#endif
#define RS_FAR_EDGE 6
#define RS_TURN ((rs_real)6.28318530717958647693)

/* One sample of the loop: all that the amplifier is asked for, at the count of this instant. */
struct rigtool_sensor_sample {
    int32_t encoder;     /* counts, rounded down, turns included */
    rs_real current;     /* A */
    rs_real temperature; /* degC, of the motor */
};

enum rigtool_sensor_state {
    RIGTOOL_SENSOR_OUTSIDE,  /* outside what was learned: no value */
    RIGTOOL_SENSOR_AGAINST,  /* moving against the load */
    RIGTOOL_SENSOR_WITH,     /* moving with the load */
    RIGTOOL_SENSOR_REVERSED, /* after a reversal */
    RIGTOOL_SENSOR_STILL     /* standing still */
};

/* All but the state are NaN where there is no value. */
struct rigtool_sensor_reading {
    rs_real torque;    /* N m on the output, positive where it resists positive motion */
    rs_real u;         /* its standard uncertainty, N m */
    rs_real low, high; /* of the 95 % interval, N m */
    enum rigtool_sensor_state state;
    int fresh; /* 1 where this sample completed a step, 0 where the reading is that of before */
};

/* Order of the filter's states; those from RS_TORQUE on change from step to step alone. */
enum {
    RS_ANGLE,         /* of the rotor from the count that was read last, rad */
    RS_SPEED,         /* rad/s */
    RS_BRISTLE,       /* of the bearings, of its deflection while sliding */
    RS_HOUSING,       /* bristle of the housing */
    RS_GRASPER,       /* angle of the output from that count, rad */
    RS_GRASPER_SPEED, /* rad/s */
    RS_TIP,           /* bristle of the tip */
    RS_TORQUE,        /* N m on the output */
    RS_NOISE,         /* of friction, N m */
    RS_SINE,          /* deviation of the stroke, N m */
    RS_COSINE,
    RS_LOAD, /* deviation of friction with load, relative */
    RS_STATES,
    RS_MOVING = RS_TORQUE,
    RS_STROKE = RS_SINE,
    RS_NOISY = RS_STROKE - RS_MOVING, /* change at random from step to step */
    RS_ORDER = 2, /* of the low-pass */
    /* what the error depends on: the state, or that the rotor slides, but creeps */
    RS_CREEPING = RIGTOOL_SENSOR_STILL + 1,
    RS_KINDS
};

/* Of the ripple that a power-up draws: orders, those that are followed, their waves, and the states
 * of what learns them: torque, a load that hangs, waves; powers of the current in the variance of
 * the rest. Filters: near the learned ripple, another one, and both again with such a load. */
enum { RS_ORDERS = 14, RS_FOLLOWED = 6, RS_WAVES = 2 * RS_FOLLOWED, RS_POWERS = 3 };
enum { RS_HUNG = 1, RS_WAVE = 4, RS_PARTS = RS_WAVE + RS_WAVES, RS_FILTERS = 4 };

/* Columns of the rotor's map. */
enum { RS_COGGING, RS_RIPPLE, RS_GAIN, RS_SQUARE, RS_VISCOUS, RS_COLUMNS };

/* What was learned. SI. */
struct rs_model {
    rs_real sample_time; /* of the equations, s */
    rs_real step_time;   /* between two angles that the filter takes in, s */
    rs_real count;       /* of the encoder, rad */
    int32_t turn;        /* counts */
    uint64_t output_turn; /* turns of the output for a count, 2^-64 */
    rs_real constant, constant_slope;   /* torque at 0 degC, N m/A, and its change per kelvin */
    rs_real offset_current; /* A */
    rs_real ripple_kept, delay_kept; /* what a sample leaves of the lagging ripple and torque */
    /* the drive: experiments/force_filter/plant.py has the equations */
    rs_real inertia, coulomb, static_friction, stribeck_velocity, presliding_angle;
    rs_real asymmetry, presliding_damping, angle_ratio, torque_factor, stiffness, damping;
    rs_real grasper_inertia, housing_friction, housing_asymmetry, housing_presliding_angle;
    rs_real tip_friction, tip_presliding_angle, load_friction, load_friction_onset;
    /* how far the equations may be off: standard deviations, and squares of random walks a step */
    rs_real stroke, load_stroke, friction_noise, noise_kept, undecided, edge;
    rs_real torque_start, bristle_start, speed_start;
    rs_real quiet_walk, slow_walk, step_walk, walk[RS_MOVING];
    rs_real short_kept, long_kept, step_threshold, slow_threshold, least_variance;
    rs_real busy_kept, busy_steps, busy_whole, most_busy;
    /* ripple of another power-up: experiments/force_sensor/power_up/power_up.py has them */
    rs_real wave_kept, wave_held, wave_shown, wave_slow, wave_turn;
    int wave_order[RS_FOLLOWED]; /* they rise */
    /* lag, and what is not followed by order: square, and squares by powers of the current; what
     * the followed orders grow by: per torque of the current, per that and the current's size */
    rs_real wave_lag, wave_unfollowed[RS_ORDERS][1 + RS_POWERS], wave_growth[RS_FOLLOWED][2];
    /* under either hypothesis, the learned power-up first */
    rs_real wave_mean[2][RS_WAVES], wave_variance[2][RS_WAVES], wave_doubt[2][RS_WAVES];
    rs_real wave_square; /* the sum of the amplitudes' squares */
    rs_real row_noise, row_walk[2], row_reversal, row_contact, row_untouched, row_kept;
    rs_real row_begins, row_ends, row_changes, row_least, row_evidence, row_certain, row_largest;
    rs_real row_recognised, row_lasts, row_lasting, row_drift, row_least_lasts, row_same;
    rs_real row_beforehand, row_hangs, row_hanging[RS_WAVE - RS_HUNG];
    /* states */
    rs_real sliding, slow, crawling, speed_limit, torque_limit;
    rs_real current_limit, largest_current, cold, warm, farthest;
    int32_t lowest, highest; /* counts */
    /* the reading: low-pass q' = A q + B M, y = C q + D M, and u^2 = (c s)^2 + (g y)^2 of its
     * deviation s, by state, and while the rotor creeps, c^2 at least `shown_variance` where y
     * shows; the ripple's variance is added, and at rest one by the asymmetry of friction */
    rs_real low_pass[RS_ORDER + 1][RS_ORDER + 1], settled[RS_ORDER], scales[RS_KINDS][2], coverage;
    rs_real shown_variance, rest_variance;
    /* what friction leaves open without a current, and where the rotor crawls besides; within a
     * count, where the rotor of a driven motor has been in it for long, or the torque swings */
    rs_real no_current, open_variances[2][RS_KINDS], held_variance;
    /* while the rotor creeps by steps: experiments/force_filter/creeping.py */
    rs_real creep_more, creep_variance;
    /* of a torque that swings: experiments/force_filter/swinging.py */
    rs_real level_kept, swing_grows, swing_falls, least_swing, swing_taken;
};

#ifdef __GNUC__ /* numbers of 17 digits are rounded on purpose */
#pragma GCC diagnostic push
#ifdef __clang__
#pragma GCC diagnostic ignored "-Wimplicit-float-conversion"
#else
#pragma GCC diagnostic ignored "-Wfloat-conversion"
#endif
#endif

@DATA@
#ifdef __GNUC__
#pragma GCC diagnostic pop
#endif

/* A wave as the filter's torque shows it, and what the other states are then off by. */
struct rs_shown {
    rs_real seen, angle, speed, housing, sine, cosine;
};

/* Where U, whose diagonal is 1, holds row i of column j > i: one column after the other. */
#define RS_AT(i, j) ((j) * ((j) - 1) / 2 + (i))

/* What is known of the ripple of this power-up: mean, and covariance as U diag(d) U' again. */
struct rs_ripple {
    rs_real mean[RS_PARTS], u[RS_AT(0, RS_PARTS)], d[RS_PARTS];
    /* a contact that lasts: what 1 N m of it changes the means by; its mean and variance */
    rs_real shift[RS_PARTS], lasting[2];
};

/* A filter of that ripple: what is known, and was, and which of both is the earlier; the
 * probabilities that something touches, and that a contact lasts; rows since the later one, negative
 * after a contact, until there is a later one. */
struct rs_filter {
    struct rs_ripple known, before[2];
    rs_real touched, lasts;
    int since, earlier;
};

/* The filter; its numbers are for nobody else. */
struct rigtool_sensor {
    /* samples until they are one of the equations */
    int collected, limited, limited_before, heard, last_limited;
    struct rigtool_sensor_sample last;
    int32_t encoder; /* counts, of now */
    rs_real current, current_before, temperature, temperature_before;
    /* x, and its covariance as U diag(d) U'; rows of U that move are those of now within a step.
     * The last columns of u are the covariance of x and q; nothing depends on it. */
    rs_real x[RS_STATES], u[RS_STATES][RS_STATES + RS_ORDER], d[RS_STATES];
    rs_real q[RS_ORDER], own[RS_ORDER][RS_ORDER]; /* of the low-pass, and their covariance */
    rs_real ripple, late, direction, step_sum, slow_sum, spread, outer_spread;
    int step_left, slow_left; /* steps at the level of a step, of a slow change */
    rs_real busy;             /* part of the time at either level */
    int32_t base; /* count that the angles are from */
    int32_t counted; /* by the step before, which left this of the angle; variance 0: none yet */
    rs_real left_angle, left_variance;
    int rested_up, rested_down; /* steps within this count and the next, the last one */
    int none_before, none_steps, idle; /* without a current: a sample, steps so far, for long */
    rs_real turn; /* of the output at this count, in turns */
    rs_real at, sine, cosine; /* of the output at the begin of the step */
    int begun, samples, creeps, crawls;
    /* the row that is filled, torque first; the last wave is what is taken off the drive torque, by
     * `held` */
    struct rs_shown shown[RS_WAVES + 1];
    rs_real gain[RS_STATES], stroke;
    rs_real taken;
    int held_steps;
    rs_real lagged[2]; /* torque of the current, and that by its size, behind the lag */
    rs_real waves[RS_WAVES + 1], row[RS_PARTS], ripple_q[RS_ORDER];
    rs_real level[2], level_variance[2]; /* where something touches: by a slow, a fast walk */
    int row_steps, row_slid;
    /* states: counts of the last steps, and for how many steps they were one of two */
    int32_t history[RS_SPEED_STEPS];
    int steps, next, still_up, still_down, limit_left;
    /* where the rotor turned or rested: count, the farthest since, direction, what the bristle
     * lacked; steps at rest; since it began to swing */
    int32_t turned, farthest;
    rs_real side, lacked;
    int rested, swung;
    rs_real level_torque, swing; /* mean of the torque, median of how far it is away, squared */
    struct rigtool_sensor_reading reading;
    /* what holds until samples are missing, first: the sample that holds, and for how many */
    struct rigtool_sensor_sample known;
    int holds;
    int32_t read, usual; /* count of the sample before, and the step to it, without a leap */
    int reads, unchanged; /* samples, two at most; without a count, until they are a rest */
    /* what holds until the power is cut, first: counts that are taken off what is read */
    int32_t lost;
    int followed; /* the ripple, since a begin */
    struct rs_filter filters[RS_FILTERS];
    rs_real held[RS_WAVES];
    rs_real hangs[2]; /* the probability that a load hangs, with either ripple */
    rs_real other, proven; /* logarithm of the likelihoods' ratio, of both ripples; what stays */
    /* of all: both weights, the rest is the learned ripple's, and what they count in the variance;
     * mean of the ripple, and variance */
    rs_real weights[2], counts[2], ripples[RS_WAVES], ripple_spread, unfollowed[1 + RS_POWERS];
    rs_real fast; /* the probability of a fast walk */
    int row_length, row_drawn;
    int doubted; /* the wave whose doubt grows next, of the filter in turn */
};

static inline rs_real rs_square(rs_real value)
{
    return value * value;
}

/* 1, 0 or -1. */
static inline rs_real rs_sign(rs_real value)
{
    return (rs_real)(value > 0 ? 1 : value < 0 ? -1 : 0);
}

/* A value within +-limit; the C library's functions test for NaN first. */
static inline rs_real rs_within(rs_real value, rs_real limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

/* isfinite without a call of the C library. */
static inline int rs_finite(rs_real value)
{
    return value - value >= 0;
}

/* Counts from one to another, across an overflow, too. */
static inline int32_t rs_from(int32_t to, int32_t from)
{
    return (int32_t)((uint32_t)to - (uint32_t)from);
}

/* -- the drive ------------------------------------------------------------------------------- */

/* The part of a turn, from turns between -1000 and 1000; beyond them, 0. */
static inline rs_real rs_part(rs_real turns)
{
    if (!(turns > -1000 && turns < 1000))
        return 0;
    return turns + (rs_real)(turns < 0) - (rs_real)(int)turns;
}

/* The part of a turn at which the rotor is, in the middle of its count. */
static inline rs_real rs_rotor(const struct rigtool_sensor *s)
{
    const int32_t turn = rs_model.turn, within = s->encoder % turn;
    return ((rs_real)(within < 0 ? within + turn : within) + (rs_real)0.5) * (1 / (rs_real)turn);
}

/* Place in a map of one turn, of which a part has passed: the cell, and the part of it. */
static inline int rs_place(rs_real passed, int cells, rs_real *part)
{
    const rs_real place = passed * (rs_real)cells;
    int cell = (int)place;
    if (cell > cells - 1)
        cell = cells - 1; /* rounding */
    *part = place - (rs_real)cell;
    return cell;
}

#ifdef RIGTOOL_SENSOR_FLOAT
/* exp(x) for x up to 0, within two roundings: x = n ln 2 + r, and a polynomial of r. */
static inline rs_real rs_exp(rs_real x)
{
    rs_real scaled = x * 1.44269504f - 0.5f, r, power;
    uint32_t bits;
    if (!(scaled > -125.0f))
        return 0;
    bits = (uint32_t)(127 + (int32_t)scaled);
    r = (rs_real)(int32_t)scaled;
    r = (x - r * 0.693359375f) + r * 2.12194440e-4f;
    bits <<= 23;
    memcpy(&power, &bits, sizeof power);
    return power * (1 + r * (1 + r * (0.5f + r * (0.16666667f + r * (0.041666651f
                    + r * (8.3333755e-3f + r * 1.3888889e-3f))))));
}

/* Sine and cosine of a part of a turn, within two roundings: by the nearest quarter. */
static inline void rs_turned(rs_real part, rs_real *sine, rs_real *cosine)
{
    const int quarter = (int)(4 * part + 0.5f);
    const rs_real r = (4 * part - (rs_real)quarter) * 1.57079633f, x = r * r;
    const rs_real s = r - r * x * (0.166666655f - x * (8.33216087e-3f - x * 1.95152959e-4f));
    const rs_real c = 1 - x * (0.5f - x * (4.16666457e-2f - x * (1.38873163e-3f
                    - x * 2.44331571e-5f)));
    *sine = quarter % 2 ? c : s;
    *cosine = quarter % 2 ? -s : c;
    if (quarter & 2) {
        *sine = -*sine;
        *cosine = -*cosine;
    }
}
#else
#define rs_exp exp

static inline void rs_turned(rs_real part, rs_real *sine, rs_real *cosine)
{
    *sine = sin(part * RS_TURN);
    *cosine = cos(part * RS_TURN);
}
#endif

/* A bristle a sample later, and its derivatives: by itself, and by the speed. */
struct rs_bristle {
    rs_real after, by_self, by_speed;
};

static inline struct rs_bristle rs_bend(rs_real z, rs_real speed, rs_real length, rs_real spread)
{
    const rs_real dt = rs_model.sample_time;
    struct rs_bristle found;
    rs_real left = rs_exp(-RS_MATH(fabs)(speed) * (dt / length));
    rs_real side = speed > 0 ? (rs_real)1 : (rs_real)-1;
    found.after = side - (side - z) * left;
    found.by_self = left;
    if (RS_MATH(fabs)(speed) < spread)
        side = speed / spread; /* a direction that is not certain: between both */
    found.by_speed = (1 - side * z) * left * (dt / length);
    return found;
}

/* Torque of current and rotor angle at the shaft; *viscous is the drag there, N m s/rad. */
static inline rs_real rs_drive(struct rigtool_sensor *s, rs_real *viscous)
{
    const struct rs_model *m = &rs_model;
    const rs_real *low, *high;
    rs_real part, plain, raw, here[RS_COLUMNS];
    int cell = rs_place(rs_rotor(s), RS_ROTOR_CELLS, &part), j;
    low = rs_rotor_map[cell];
    high = rs_rotor_map[cell + 1];
    for (j = 0; j < RS_COLUMNS; j++)
        here[j] = low[j] + part * (high[j] - low[j]);
    plain = (m->constant + m->constant_slope * s->temperature) * (s->current + m->offset_current);
    raw = here[RS_RIPPLE]
        + plain * (here[RS_GAIN] + RS_MATH(fabs)(s->current) * here[RS_SQUARE]);
    s->ripple += (1 - m->ripple_kept) * (raw - s->ripple);
    s->late += (1 - m->delay_kept) * (plain - s->late);
    *viscous = here[RS_VISCOUS];
    return s->late - here[RS_COGGING] - s->ripple - s->taken;
}

/* Where the output is at the begin of a step, or where it has turned far within one. */
static inline void rs_locate(struct rigtool_sensor *s)
{
    s->at = s->x[RS_GRASPER];
    rs_turned(rs_part(s->turn + s->at * (1 / RS_TURN)), &s->sine, &s->cosine);
}

/* Advance the states, and with them the columns of U, by one sample of the equations. */
static inline void rs_advance(struct rigtool_sensor *s, rs_real torque, rs_real viscous)
{
    const struct rs_model *m = &rs_model;
    const rs_real dt = m->sample_time, k = m->stiffness, c = m->damping;
    const rs_real e = dt / m->inertia, f = dt / m->grasper_inertia, ratio = 1 / m->angle_ratio;
    rs_real *x = s->x, w = x[RS_SPEED], v = x[RS_GRASPER_SPEED];
    struct rs_bristle z = rs_bend(x[RS_BRISTLE], w, m->presliding_angle, s->spread);
    struct rs_bristle h = rs_bend(x[RS_HOUSING], w, m->housing_presliding_angle, s->spread);
    struct rs_bristle t = rs_bend(x[RS_TIP], v, m->tip_presliding_angle, s->outer_spread);
    rs_real twist = k * (x[RS_ANGLE] * ratio - x[RS_GRASPER]) + c * (w * ratio - v);

    /* bearings */
    rs_real fast = w * (1 / m->stribeck_velocity), rate = m->presliding_damping / dt;
    rs_real bump = RS_MATH(fabs)(fast) < 5
        ? (m->static_friction - m->coulomb) * rs_exp(-fast * fast) : 0;
    rs_real level = m->coulomb + bump;
    rs_real leaning = m->asymmetry * z.after;
    rs_real shape = (1 + leaning) * z.after + rate * (z.after - x[RS_BRISTLE]);
    rs_real bearings = level * shape + x[RS_NOISE] * z.after + viscous * w;
    rs_real by_z = level * (1 + 2 * leaning + rate) + x[RS_NOISE];
    rs_real by_w = viscous - 2 / m->stribeck_velocity * fast * bump * shape;

    /* housing; sine and cosine by series that end, so within 3e-9 */
    if (RS_MATH(fabs)(x[RS_GRASPER] - s->at) > (rs_real)0.05)
        rs_locate(s);
    rs_real part, on = x[RS_GRASPER] - s->at, squared = on * on;
    int cell = rs_place(
        rs_part(s->turn + x[RS_GRASPER] * (1 / RS_TURN)), RS_HOUSING_CELLS, &part);
    const rs_real *low = rs_housing_map[cell], *high = rs_housing_map[cell + 1];
    rs_real slope = high[0] - low[0], load_slope = high[1] - low[1];
    rs_real map = low[0] + part * slope;
    rs_real shift = on * (1 - squared * ((rs_real)1 / 6));
    rs_real held = 1 - squared * (rs_real)0.5 * (1 - squared * ((rs_real)1 / 12));
    rs_real sine = s->sine * held + s->cosine * shift;
    rs_real cosine = s->cosine * held - s->sine * shift;
    rs_real root = RS_MATH(sqrt)(twist * twist + rs_square(m->load_friction_onset));
    rs_real carried = (root - m->load_friction_onset) * (1 / m->torque_factor);
    rs_real sided = m->housing_friction * m->housing_asymmetry * h.after;
    rs_real per_load = m->load_friction * (1 + x[RS_LOAD]) + low[1] + part * load_slope;
    rs_real waves = x[RS_SINE] * sine + x[RS_COSINE] * cosine;
    rs_real housing = m->housing_friction * map + sided + per_load * carried + waves;
    rs_real by_h = housing + sided;
    rs_real by_twist = 1 / m->torque_factor * (1 + per_load * twist / root * h.after);
    rs_real by_a = ((m->housing_friction * slope + carried * load_slope)
                        * (RS_HOUSING_CELLS / RS_TURN)
                    + x[RS_SINE] * cosine - x[RS_COSINE] * sine) * h.after;

    /* speed of rotor and output a sample later, by what was before */
    const rs_real w_by_angle = -e * by_twist * k * ratio;
    const rs_real w_by_w =
        1 - e * (by_z * z.by_speed + by_w + by_h * h.by_speed + by_twist * c * ratio);
    const rs_real w_by_z = -e * (by_z * z.by_self - level * rate), w_by_h = -e * by_h * h.by_self;
    const rs_real w_by_a = e * (by_twist * k - by_a), w_by_v = e * by_twist * c;
    const rs_real w_by[] = {-e * z.after, -e * h.after * sine, -e * h.after * cosine,
                            -e * m->load_friction * carried * h.after}; /* from RS_NOISE on */
    const rs_real v_by_v = 1 - f * (c + m->tip_friction * t.by_speed);
    const rs_real v_by_t = -f * m->tip_friction * t.by_self;
    rs_real (*u)[RS_STATES + RS_ORDER] = s->u;
    int i, j;

    x[RS_SPEED] += e * (torque - bearings - twist * (1 / m->torque_factor) - housing * h.after);
    x[RS_ANGLE] += dt * x[RS_SPEED];
    x[RS_GRASPER_SPEED] += f * (twist - m->tip_friction * t.after - x[RS_TORQUE]);
    x[RS_GRASPER] += dt * x[RS_GRASPER_SPEED];
    x[RS_BRISTLE] = z.after;
    x[RS_HOUSING] = h.after;
    x[RS_TIP] = t.after;

    RS_UNROLL
    for (j = 0; j < RS_STATES + RS_ORDER; j++) {
        const rs_real d_angle = u[RS_ANGLE][j], d_w = u[RS_SPEED][j];
        const rs_real d_a = u[RS_GRASPER][j], d_v = u[RS_GRASPER_SPEED][j];
        rs_real new_w = w_by_angle * d_angle + w_by_w * d_w + w_by_a * d_a + w_by_v * d_v
            + w_by_z * u[RS_BRISTLE][j] + w_by_h * u[RS_HOUSING][j];
        rs_real new_v = f * k * ratio * d_angle + f * c * ratio * d_w - f * k * d_a
            + v_by_v * d_v + v_by_t * u[RS_TIP][j];
        if (j >= RS_MOVING) {
            for (i = RS_NOISE; i < RS_STATES && i <= j; i++)
                new_w += w_by[i - RS_NOISE] * u[i][j];
            new_v -= f * u[RS_TORQUE][j];
        }
        u[RS_BRISTLE][j] = z.by_self * u[RS_BRISTLE][j] + z.by_speed * d_w;
        u[RS_HOUSING][j] = h.by_self * u[RS_HOUSING][j] + h.by_speed * d_w;
        u[RS_TIP][j] = t.by_self * u[RS_TIP][j] + t.by_speed * d_v;
        u[RS_ANGLE][j] = d_angle + dt * new_w;
        u[RS_SPEED][j] = new_w;
        u[RS_GRASPER][j] = d_a + dt * new_v;
        u[RS_GRASPER_SPEED][j] = new_v;
    }
}

/* -- the covariance U diag(d) U', U unit upper triangular -------------------------------------- */

/* Variance of a state. */
static inline rs_real rs_variance(const struct rigtool_sensor *s, int i)
{
    rs_real total = s->d[i];
    int j;
    for (j = i + 1; j < RS_STATES; j++)
        total += s->u[i][j] * s->u[i][j] * s->d[j];
    return total;
}

/* Add weight a a' to the covariance, from row `from`, with which a ends, down to row `to`:
 * W. S. Agee, R. H. Turner 1972 (Bierman III.4). What is left to add to the rows before is in a,
 * by the weight returned. */
static inline rs_real rs_add(struct rigtool_sensor *s, rs_real weight, rs_real *a, int from, int to)
{
    int i, j;
    for (j = from; j >= to; j--) {
        const rs_real old = s->d[j], part = weight * a[j], whole = old + part * a[j];
        const rs_real inverse = 1 / whole, gain = part * inverse;
        s->d[j] = whole;
        for (i = 0; i < j; i++) {
            a[i] -= a[j] * s->u[i][j];
            s->u[i][j] += gain * a[i];
        }
        weight *= old * inverse;
    }
    return weight;
}

/* Add a variance to a state's; what is left for the rows that move is in a, as in `rs_add`. */
static inline rs_real rs_add_walk(struct rigtool_sensor *s, rs_real variance, rs_real *a, int state)
{
    const rs_real whole = s->d[state] + variance, kept = s->d[state] / whole;
    int i;
    s->d[state] = whole;
    for (i = 0; i < state; i++) {
        a[i] = s->u[i][state]; /* of either sign */
        s->u[i][state] *= kept;
    }
    return rs_add(s, variance * kept, a, state - 1, RS_MOVING);
}

/* Rows that move with what is added to them, each column by its weight: those of U by d, `other` by
 * `weight`, and each row's random walk, a column of its own that begins as 1. */
struct rs_rows {
    rs_real other[RS_NOISY][RS_STROKE], weight[RS_NOISY];
    rs_real walk[RS_MOVING][RS_MOVING]; /* above the diagonal; below it that of U */
    rs_real d[RS_MOVING];
};

/* Make the rows before row j independent of it. */
static inline void rs_apart(struct rigtool_sensor *s, struct rs_rows *r, int j)
{
    /* copies, since no store to another row changes them */
    rs_real row[RS_MOVING], noisy[RS_NOISY], walk[RS_MOVING];
    rs_real by_d[RS_MOVING], by_weight[RS_NOISY], by_walk[RS_MOVING], total = rs_model.walk[j];
    int i, m;
    for (m = 0; m < RS_MOVING; m++) {
        row[m] = s->u[j][m];
        by_d[m] = s->d[m] * row[m];
        total += by_d[m] * row[m];
    }
    for (m = 0; m < RS_NOISY; m++) {
        noisy[m] = r->other[m][j];
        by_weight[m] = r->weight[m] * noisy[m];
        total += by_weight[m] * noisy[m];
    }
    for (m = j + 1; m < RS_MOVING; m++) {
        walk[m] = r->walk[j][m];
        by_walk[m] = rs_model.walk[m] * walk[m];
        total += by_walk[m] * walk[m];
    }
    r->d[j] = total;
    total = 1 / total;
    for (i = 0; i < j; i++) {
        rs_real *before = s->u[i], dot = 0;
        for (m = 0; m < RS_MOVING; m++)
            dot += by_d[m] * before[m];
        for (m = 0; m < RS_NOISY; m++)
            dot += by_weight[m] * r->other[m][i];
        for (m = j + 1; m < RS_MOVING; m++)
            dot += by_walk[m] * r->walk[i][m];
        dot *= total;
        for (m = 0; m < RS_MOVING; m++)
            before[m] -= dot * row[m];
        for (m = 0; m < RS_NOISY; m++)
            r->other[m][i] -= dot * noisy[m];
        for (m = j + 1; m < RS_MOVING; m++)
            r->walk[i][m] -= dot * walk[m];
        r->walk[i][j] = -dot;
        r->walk[j][i] = dot;
    }
}

/* Make the rows that move triangular again: modified weighted Gram-Schmidt, C. L. Thornton 1976
 * (Bierman VI.4). */
static inline void rs_triangular(struct rigtool_sensor *s, struct rs_rows *r)
{
    int i, j;
    RS_UNROLL
    for (j = RS_MOVING - 1; j >= 0; j--)
        rs_apart(s, r, j);
    RS_UNROLL
    for (j = 0; j < RS_MOVING; j++) {
        s->d[j] = r->d[j];
        s->u[j][j] = 1;
        for (i = 0; i < j; i++) {
            s->u[j][i] = 0;
            s->u[i][j] = r->walk[j][i];
        }
    }
}

/* A new stroke: its deviations are drawn anew, what they did to the other states stays. */
static inline void rs_new_stroke(struct rigtool_sensor *s)
{
    int i, j;
    for (j = RS_STROKE; j < RS_STATES; j++) {
        rs_real a[RS_STROKE];
        for (i = 0; i < RS_STROKE; i++)
            a[i] = s->u[i][j];
        rs_add(s, s->d[j], a, RS_STROKE - 1, 0);
        for (i = 0; i < j; i++)
            s->u[i][j] = 0;
        for (i = 0; i < RS_ORDER; i++)
            s->u[j][RS_STATES + i] = 0;
        s->x[j] = 0;
        s->d[j] = rs_square(j == RS_LOAD ? rs_model.load_stroke : rs_model.stroke);
    }
}

/* -- a step of the filter ---------------------------------------------------------------------- */

/* Advance the low-pass by a step, with its covariances. */
static inline void rs_pass(struct rigtool_sensor *s)
{
    rs_real part[RS_STATES], torque[RS_STATES]; /* covariance of x and the torque */
    rs_real q[RS_ORDER], own[RS_ORDER][RS_ORDER];
    int i, j, m, n;
    for (j = RS_TORQUE; j < RS_STATES; j++)
        part[j] = s->d[j] * s->u[RS_TORQUE][j];
    RS_UNROLL
    for (n = 0; n < RS_STATES; n++) {
        torque[n] = 0;
        for (j = n < RS_TORQUE ? RS_TORQUE : n; j < RS_STATES; j++)
            torque[n] += s->u[n][j] * part[j];
    }
    for (i = 0; i < RS_ORDER; i++) {
        const rs_real *a = rs_model.low_pass[i];
        q[i] = a[RS_ORDER] * s->x[RS_TORQUE];
        for (m = 0; m < RS_ORDER; m++)
            q[i] += a[m] * s->q[m];
        for (j = 0; j <= i; j++) {
            const rs_real *b = rs_model.low_pass[j];
            rs_real total = a[RS_ORDER] * torque[RS_TORQUE] * b[RS_ORDER];
            for (m = 0; m < RS_ORDER; m++) {
                total += (a[m] * b[RS_ORDER] + a[RS_ORDER] * b[m]) * s->u[RS_TORQUE][RS_STATES + m];
                for (n = 0; n <= m; n++) /* it is symmetrical */
                    total += s->own[m][n] * (m == n ? a[m] * b[n] : a[m] * b[n] + a[n] * b[m]);
            }
            own[i][j] = own[j][i] = total;
        }
    }
    for (n = 0; n < RS_STATES; n++) {
        rs_real *row = s->u[n] + RS_STATES, shared[RS_ORDER];
        for (i = 0; i < RS_ORDER; i++) {
            shared[i] = torque[n] * rs_model.low_pass[i][RS_ORDER];
            for (m = 0; m < RS_ORDER; m++)
                shared[i] += row[m] * rs_model.low_pass[i][m];
        }
        for (i = 0; i < RS_ORDER; i++)
            row[i] = shared[i];
    }
    for (i = 0; i < RS_ORDER; i++) {
        s->q[i] = q[i];
        for (j = 0; j < RS_ORDER; j++)
            s->own[i][j] = own[i][j];
    }
}

/* What is needed of the states before the samples of a step. */
static inline void rs_ahead(struct rigtool_sensor *s)
{
    s->spread = rs_model.undecided * RS_MATH(sqrt)(rs_variance(s, RS_SPEED));
    s->outer_spread = rs_model.undecided * RS_MATH(sqrt)(rs_variance(s, RS_GRASPER_SPEED));
    rs_pass(s);
}

/* Count the steps within two counts; whether a rest has lasted, or ends. */
static inline int rs_limits_rest(struct rigtool_sensor *s)
{
    const int32_t moved = rs_from(s->encoder, s->counted);
    const int up = s->rested_up, down = s->rested_down, before = up > down ? up : down;
    int after;
    s->rested_up = moved == 0 ? up + 1 : moved == -1 ? down + 1 : 0;
    s->rested_down = moved == 0 ? down + 1 : moved == 1 ? up + 1 : 0;
    if (s->rested_up > RS_REST_STEPS)
        s->rested_up = RS_REST_STEPS + 1;
    if (s->rested_down > RS_REST_STEPS)
        s->rested_down = RS_REST_STEPS + 1;
    after = s->rested_up > s->rested_down ? s->rested_up : s->rested_down;
    return (before > RS_REST_STEPS && after < RS_REST_STEPS) ||
           (after > RS_REST_STEPS && before <= RS_REST_STEPS);
}

/* The end of the samples of a step: what the equations do not know is added. */
static inline void rs_predicted(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    const rs_real kept = m->noise_kept, forgotten = 1 / kept;
    struct rs_rows rows;
    rs_real added[RS_NOISY];
    int i, fresh;
    s->x[RS_NOISE] *= kept;
    for (i = 0; i < RS_NOISE; i++)
        s->u[i][RS_NOISE] *= forgotten;
    for (i = RS_NOISE + 1; i < RS_STATES + RS_ORDER; i++)
        s->u[RS_NOISE][i] *= kept;
    s->d[RS_NOISE] *= kept * kept;
    added[RS_NOISE - RS_MOVING] = rs_square(m->friction_noise) * (1 - kept * kept);
    added[RS_TORQUE - RS_MOVING] =
        s->step_left > 0 ? m->step_walk : s->slow_left > 0 ? m->slow_walk : m->quiet_walk;
    if (s->step_left > 0)
        s->step_left--;
    if (s->slow_left > 0)
        s->slow_left--;
    for (i = RS_NOISY - 1; i >= 0; i--)
        rows.weight[i] = rs_add_walk(s, added[i], rows.other[i], RS_MOVING + i);
    rs_triangular(s, &rows);
    fresh = rs_limits_rest(s);
    if (s->x[RS_HOUSING] * s->direction < (rs_real)-0.5) {
        s->direction = -s->direction;
        fresh = 1;
    }
    if (fresh)
        rs_new_stroke(s);
}

/* Mean of a density exp(-slope x) between 0 and width; *variance receives its variance. */
static inline rs_real rs_exponential(rs_real slope, rs_real width, rs_real *variance)
{
    rs_real end;
    if (slope * width < RS_STRAIGHT) {
        *variance = width * width / 12;
        return width * ((rs_real)0.5 - slope * width / 12);
    }
    end = rs_exp(-slope * width);
    *variance = 1 / (slope * slope) - width * width * end / ((1 - end) * (1 - end));
    return 1 / slope - width * end / (1 - end);
}

/* What Mills' ratio of a normal's tail beyond x, 1 / (x + found), has besides x. */
static inline rs_real rs_beyond(rs_real x)
{
    rs_real found = 0;
    int n;
    for (n = RS_TERMS; n > 0; n--)
        found = (rs_real)n / (x + found);
    return found;
}

/* Mean, from alpha on, of a standard normal between edges in its tail; *variance receives its
 * variance: experiments/force_filter/interval.py has the equations. */
static inline rs_real rs_far_out(rs_real alpha, rs_real beta, rs_real *variance)
{
    const rs_real width = beta - alpha, beyond = rs_beyond(alpha), next_beyond = rs_beyond(beta);
    const rs_real ratio = 1 / (alpha + beyond);
    const rs_real next_part = rs_exp((rs_real)-0.5 * width * (alpha + beta));
    const rs_real next_ratio = next_part / (beta + next_beyond), tail = ratio - next_ratio;
    const rs_real mean = (ratio * beyond - next_ratio * (next_beyond + width)) / tail;
    *variance = 1 - alpha * mean - width * next_part / tail - mean * mean;
    return mean;
}

/* Mean of a standard normal between alpha and beta; *variance receives its variance. */
static inline rs_real rs_truncated(rs_real alpha, rs_real beta, rs_real *variance)
{
    const rs_real root = (rs_real)0.70710678118654752440, density = (rs_real)0.39894228040143267794;
    rs_real sign = 1, mean, tail, low, high, swap;
    if (alpha + beta < 0) { /* above zero the tails are those that erfc resolves */
        swap = alpha;
        alpha = -beta;
        beta = -swap;
        sign = -1;
    }
    if (beta - alpha < RS_NARROWEST)
        return sign * (alpha + rs_exponential((alpha + beta) / 2, beta - alpha, variance));
    if (alpha > RS_FAR_EDGE)
        return sign * (alpha + rs_far_out(alpha, beta, variance));
    tail = (rs_real)0.5 * (RS_MATH(erfc)(alpha * root) - RS_MATH(erfc)(beta * root));
    low = density * rs_exp((rs_real)-0.5 * alpha * alpha) / tail;
    high = density * rs_exp((rs_real)-0.5 * beta * beta) / tail;
    mean = low - high;
    *variance = 1 + alpha * low - (high > 0 ? beta * high : 0) - mean * mean;
    return sign * mean;
}

/* Angles are from now on from another count. */
static inline void rs_rebase(struct rigtool_sensor *s, int32_t count)
{
    rs_real moved = (rs_real)rs_from(count, s->base) * rs_model.count;
    uint32_t turn;
    s->x[RS_ANGLE] -= moved;
    s->x[RS_GRASPER] -= moved / rs_model.angle_ratio;
    s->base = count;
    turn = (uint32_t)((uint64_t)(int64_t)count * rs_model.output_turn >> 32);
    s->turn = (rs_real)turn * (1 / (rs_real)4294967296.0);
}

/* What a count shows anew of the angle: its shift; *left receives the part of the variance. */
static inline rs_real rs_shows(struct rigtool_sensor *s, rs_real variance, rs_real *left)
{
    const struct rs_model *m = &rs_model;
    const rs_real deviation = RS_MATH(sqrt)(variance), low = -s->x[RS_ANGLE] / deviation;
    rs_real shift = rs_truncated(low, low + m->count / deviation, left) * deviation;
    if (!(*left > m->least_variance))
        *left = m->least_variance;
    if (s->encoder == s->counted && s->left_variance > 0) {
        const rs_real before = RS_MATH(sqrt)(s->left_variance), at = -s->left_angle / before;
        rs_real known, fresh;
        fresh = shift - rs_truncated(at, at + m->count / before, &known) * before;
        shift = fresh * shift > 0 ? fresh : (rs_real)0;
        if (!(known > m->least_variance))
            known = m->least_variance;
        *left = *left < known ? *left / known : (rs_real)1;
    }
    return shift;
}

/* Take in a shift of the angle that leaves a part of its variance, with the edge's own: as a scalar
 * measurement, U and d after Bierman (V.3). `part` is d U'[angle]. */
static inline void rs_narrow(struct rigtool_sensor *s, rs_real edge, rs_real variance,
                             rs_real shift, rs_real left, const rs_real part[RS_STATES])
{
    rs_real weight = 1 - left, mean = shift / variance;
    rs_real shared[RS_ORDER], shared_weight[RS_ORDER], column[RS_STATES]; /* U d U'[angle] */
    int i, j;
    if (!(weight > RS_LEAST_WEIGHT))
        weight = RS_LEAST_WEIGHT;
    {
        /* a measurement of this variance leaves the same */
        rs_real sum = edge + variance * left / weight, inverse = 1 / sum;
        RS_UNROLL
        for (j = 0; j < RS_STATES; j++) {
            const rs_real by = s->u[RS_ANGLE][j], gain = -by * inverse, whole = sum + part[j] * by;
            for (i = 0; i < j; i++) {
                const rs_real old = s->u[i][j];
                s->u[i][j] = old + gain * column[i];
                column[i] += old * part[j];
            }
            column[j] = part[j];
            inverse = 1 / whole;
            s->d[j] *= sum * inverse;
            sum = whole;
        }
    }
    weight /= variance;
    for (i = 0; i < RS_ORDER; i++)
        shared[i] = s->u[RS_ANGLE][RS_STATES + i];
    for (i = 0; i < RS_ORDER; i++) {
        s->q[i] += shared[i] * mean;
        shared_weight[i] = shared[i] * weight;
        for (j = 0; j <= i; j++)
            s->own[i][j] = s->own[j][i] = s->own[i][j] - shared[i] * shared_weight[j];
    }
    for (i = 0; i < RS_STATES; i++) {
        s->gain[i] = column[i] * weight;
        s->x[i] += column[i] * mean;
        for (j = 0; j < RS_ORDER; j++)
            s->u[i][RS_STATES + j] -= column[i] * shared_weight[j];
    }
    s->x[RS_BRISTLE] = rs_within(s->x[RS_BRISTLE], 1);
    s->x[RS_HOUSING] = rs_within(s->x[RS_HOUSING], 1);
    s->x[RS_TIP] = rs_within(s->x[RS_TIP], 1);
}

/* Take in that the angle lies within its count. */
static inline void rs_update(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    const rs_real edge = rs_square(m->edge * m->count);
    rs_real own = 0, variance, shift, left, found, part[RS_STATES];
    int j, lasting = 0;
    for (j = 0; j < RS_STATES; j++) {
        part[j] = s->d[j] * s->u[RS_ANGLE][j];
        own += part[j] * s->u[RS_ANGLE][j];
    }
    variance = own + edge;
    shift = rs_shows(s, variance, &left);
    if (shift < 0 || shift > 0 || left < 1)
        rs_narrow(s, edge, variance, shift, left, part);
    else
        memset(s->gain, 0, sizeof s->gain);
    s->left_angle = s->x[RS_ANGLE];
    s->left_variance = edge + own - (1 - left) * own * own / variance;
    found = shift / RS_MATH(sqrt)(variance) * m->step_time;
    s->step_sum = m->short_kept * s->step_sum + found;
    s->slow_sum = m->long_kept * s->slow_sum + found;
    s->busy *= m->busy_kept;
    if (s->step_left > 0 || s->slow_left > 0)
        s->busy += 1 - m->busy_kept;
    if (RS_MATH(fabs)(s->step_sum) > m->step_threshold)
        s->step_left = RS_BUSY_STEPS;
    if (RS_MATH(fabs)(s->slow_sum) > m->slow_threshold) {
        const rs_real most = s->busy < m->most_busy ? s->busy : m->most_busy;
        lasting = (int)(m->busy_steps / (1 - most) + m->busy_whole);
    } else if (s->encoder != s->counted && s->idle)
        lasting = RS_BUSY_STEPS; /* what moves a motor without current is the torque */
    if (s->slow_left < lasting)
        s->slow_left = lasting;
    s->counted = s->encoder;
}

/* -- ripple that the amplifier draws at a power-up --------------------------------------------- */

/* Go on by orders to the followed one of a place: `one` and `wave` (2) are cosine and sine of the
 * first order, and of the last one. */
static inline void rs_next_wave(int place, const rs_real *one, rs_real *wave, rs_real *fresh)
{
    int order = place ? rs_model.wave_order[place - 1] : 0;
    for (; order < rs_model.wave_order[place]; order++) {
        const rs_real before = wave[0];
        wave[0] = wave[0] * one[0] - wave[1] * one[1];
        wave[1] = wave[1] * one[0] + before * one[1];
    }
    fresh[2 * place] = wave[0];
    fresh[2 * place + 1] = wave[1];
}

/* Waves of the rotor's angle, lagging: cosine and sine of each order. */
static inline void rs_wave(struct rigtool_sensor *s)
{
    rs_real one[2], wave[2] = {1, 0}, fresh[RS_WAVES];
    int i;
    rs_turned(rs_rotor(s), &one[1], &one[0]);
    rs_next_wave(0, one, wave, fresh); /* no loop: each place has a number of steps of its own */
    rs_next_wave(1, one, wave, fresh);
    rs_next_wave(2, one, wave, fresh);
    rs_next_wave(3, one, wave, fresh);
    rs_next_wave(4, one, wave, fresh);
    rs_next_wave(5, one, wave, fresh);
    RS_UNROLL
    for (i = 0; i < RS_WAVES; i++)
        s->waves[i] += (1 - rs_model.wave_kept) * (fresh[i] - s->waves[i]);
}

/* The logarithm of the likelihood of a row that has one's or, with a probability, the other's; the
 * probability then. */
static inline rs_real rs_weighed(rs_real *probability, rs_real one, rs_real other)
{
    rs_real largest, together;
    one += RS_MATH(log)(1 - *probability);
    other += RS_MATH(log)(*probability);
    largest = one > other ? one : other;
    together = largest + RS_MATH(log)(rs_exp(one - largest) + rs_exp(other - largest));
    *probability = rs_exp(other - together < 0 ? other - together : (rs_real)0);
    return together;
}

/* The logarithm of the density of an error. */
static inline rs_real rs_density(rs_real error, rs_real variance)
{
    return (rs_real)-0.5 * (error * error / variance + RS_MATH(log)(variance));
}

/* The logarithm of a row's likelihood where something touches; it is taken in there. */
static inline rs_real rs_touching(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    const rs_real value = s->row[0], leap = m->row_contact + m->row_noise;
    const rs_real leaps = RS_MATH(log)(m->row_changes) + rs_density(value, leap);
    rs_real likely[2];
    int i;
    for (i = 0; i < 2; i++) {
        rs_real own = s->level_variance[i] + m->row_noise, part;
        likely[i] = rs_density(value - s->level[i], own);
        if (leaps > likely[i]) {
            s->level[i] = 0;
            s->level_variance[i] = m->row_contact;
            own = leap;
            likely[i] = leaps;
        }
        part = s->level_variance[i] / own;
        s->level[i] += part * (value - s->level[i]);
        s->level_variance[i] *= 1 - part;
    }
    return rs_weighed(&s->fast, likely[0], likely[1]);
}

/* Expect of all but the torque what is expected before any row. */
static inline void rs_unknown(struct rs_ripple *known, int filter)
{
    const struct rs_model *m = &rs_model;
    int j;
    for (j = RS_HUNG; j < RS_WAVE; j++) {
        known->mean[j] = 0;
        known->d[j] = filter > 1 ? m->row_hanging[j - RS_HUNG] : (rs_real)0;
    }
    for (j = 0; j < RS_WAVES; j++) {
        known->mean[RS_WAVE + j] = m->wave_mean[filter % 2][j];
        known->d[RS_WAVE + j] = m->wave_variance[filter % 2][j];
    }
}

/* Forget another power-up's ripple: what was taken for it is too large. */
static inline void rs_begin_anew(struct rigtool_sensor *s, int filter)
{
    struct rs_filter *f = &s->filters[filter];
    int i, j;
    for (j = 1; j < RS_PARTS; j++) {
        f->known.d[0] += rs_square(f->known.u[RS_AT(0, j)]) * f->known.d[j];
        f->known.shift[j] = 0;
        for (i = 0; i < j; i++)
            f->known.u[RS_AT(i, j)] = 0;
    }
    rs_unknown(&f->known, filter);
    if ((s->hangs[1] > (rs_real)0.5) == (filter > 1)) {
        s->other = s->other > 0 ? (rs_real)0 : s->other;
        s->proven = s->proven > 0 ? (rs_real)0 : s->proven;
    }
    f->before[0] = f->before[1] = f->known;
}

/* Go back to what was known before a contact that is recognised, or keep what is known now. */
static inline void rs_take_back(struct rs_filter *h)
{
    int j;
    h->since++;
    if (h->touched > rs_model.row_recognised) {
        h->known = h->before[h->earlier];
        h->known.mean[0] = h->known.shift[0] = 0;
        h->known.d[0] = rs_model.row_untouched;
        for (j = 1; j < RS_PARTS; j++)
            h->known.u[RS_AT(0, j)] = 0;
        h->since = -RS_LATE_ROWS;
    } else if (h->since == 0) {
        h->before[!h->earlier] = h->known;
    } else if (h->since >= RS_LATE_ROWS) {
        h->before[h->earlier] = h->known;
        h->earlier = !h->earlier;
        h->since = 0;
    }
}

/* Let the doubt of a wave grow: U D U' + e q e', W. S. Agee, R. H. Turner 1972. */
static inline void rs_doubt(struct rs_ripple *known, int wave, rs_real sum)
{
    rs_real add[RS_PARTS] = {0};
    int i, j = RS_WAVE + wave;
    for (add[j] = 1; j >= 0; j--) {
        const rs_real whole = known->d[j] + sum * rs_square(add[j]);
        const rs_real gain = whole > 0 ? sum * add[j] / whole : (rs_real)0; /* no such order */
        for (i = 0; i < j; i++) {
            rs_real *u = &known->u[RS_AT(i, j)];
            add[i] -= add[j] * *u;
            *u += gain * add[i];
        }
        if (whole > 0)
            sum *= known->d[j] / whole;
        known->d[j] = whole;
    }
}

/* The logarithm of a row's likelihood where a contact lasts of which the error has `seen`; it is
 * taken in there, by the probability that nothing else touches (B. Friedland 1969). */
static inline rs_real rs_lasts(
    rs_real *lasting, rs_real error, rs_real seen, rs_real variance, rs_real untouched)
{
    const rs_real left = error - seen * lasting[0], whole = variance + seen * seen * lasting[1];
    const rs_real part = untouched * seen * lasting[1] / whole;
    lasting[0] += part * left;
    lasting[1] *= 1 - part * seen;
    return rs_density(left, whole);
}

/* Those of `rs_weighed`, of a probability that keeps away from 0 and 1. */
static inline rs_real rs_counted(rs_real *probability, rs_real one, rs_real other)
{
    const rs_real together = rs_weighed(probability, one, other), least = rs_model.row_least_lasts;
    *probability = *probability < least ? least
        : *probability > 1 - least ? 1 - least : *probability;
    return together;
}

/* The part of the logarithm of a row's likelihood by a filter, whose states but the torque begin
 * with `first`; it is taken in there. Where no load hangs, a contact may last. */
static inline rs_real rs_by_ripple(
    struct rs_filter *h, const rs_real *row, rs_real touching, int first)
{
    const struct rs_model *m = &rs_model;
    struct rs_ripple *known = &h->known;
    rs_real error = row[0] - known->mean[0], variance = m->row_noise, likely, sum, whole;
    rs_real seen = 1 + known->shift[0], before = h->touched;
    rs_real by[RS_PARTS], part[RS_PARTS], column[RS_PARTS];
    int i, j;
    by[0] = 1;
    part[0] = known->d[0];
    variance += part[0];
    RS_UNROLL
    for (j = first; j < RS_PARTS; j++) {
        const rs_real *u = &known->u[RS_AT(0, j)];
        rs_real sum_of = row[j] + u[0];
        error -= row[j] * known->mean[j];
        if (first == RS_WAVE)
            seen += row[j] * known->shift[j];
        for (i = first; i < j; i++)
            sum_of += u[i] * row[i];
        by[j] = sum_of;
        part[j] = known->d[j] * sum_of;
        variance += part[j] * sum_of;
    }
    likely = rs_weighed(&h->touched, rs_density(error, variance), touching);
    if (first == RS_WAVE) {
        rs_real other = rs_lasts(known->lasting, error, seen, variance, 1 - h->touched);
        other = rs_weighed(&before, other, touching);
        likely = rs_counted(&h->lasts, m->row_evidence * likely, m->row_evidence * other);
    } else {
        likely *= m->row_evidence;
    }
    if (h->touched > 1 - m->row_least)
        return likely;
    /* as much noise as lets the row count by the probability that nothing touches */
    sum = variance / (1 - h->touched);
    error /= sum;
    seen /= sum;
    sum -= variance - m->row_noise;
    whole = sum + part[0];
    column[0] = part[0];
    known->d[0] *= sum / whole;
    RS_UNROLL
    for (j = first; j < RS_PARTS; j++) {
        rs_real *u = &known->u[RS_AT(0, j)];
        const rs_real gain = -by[j] / whole, own = part[j], old = u[0];
        sum = whole;
        whole += own * by[j];
        u[0] = old + gain * column[0];
        column[0] += old * own;
        for (i = first; i < j; i++) {
            const rs_real was = u[i];
            u[i] = was + gain * column[i];
            column[i] += was * own;
        }
        column[j] = own;
        known->d[j] *= sum / whole;
    }
    known->mean[0] += column[0] * error;
    if (first == RS_WAVE)
        known->shift[0] -= column[0] * seen;
    for (j = first; j < RS_PARTS; j++) {
        known->mean[j] += column[j] * error;
        if (first == RS_WAVE)
            known->shift[j] -= column[j] * seen;
    }
    return likely;
}

/* What a filter expects of a wave's coefficient. */
static inline rs_real rs_expected(const struct rs_filter *h, int wave)
{
    const rs_real lasting = h->lasts * h->known.lasting[0]; /* nothing where a load hangs */
    return h->known.mean[RS_WAVE + wave] + lasting * h->known.shift[RS_WAVE + wave];
}

/* The probability of a filter under the hypothesis of its ripple: that a load hangs, or not. */
static inline rs_real rs_share(const struct rigtool_sensor *s, int filter)
{
    const rs_real hangs = s->hangs[filter % 2];
    return filter > 1 ? hangs : 1 - hangs;
}

/* The logarithm of the likelihoods' ratio of the learned ripple itself to one near it: the density
 * of no change over what it was before any row (J. M. Dickey 1971). */
static inline rs_real rs_same(const struct rs_filter *h)
{
    const rs_real *drawn = rs_model.wave_variance[0];
    rs_real left[RS_WAVES], total = 0, part = 1;
    int i, j;
    for (j = RS_WAVES - 1; j >= 0; j--) {
        const rs_real own = h->known.d[RS_WAVE + j];
        left[j] = 0;
        if (!(drawn[j] > 0)) /* no such order */
            continue;
        left[j] = rs_expected(h, j);
        for (i = j + 1; i < RS_WAVES; i++)
            left[j] -= h->known.u[RS_AT(RS_WAVE + j, RS_WAVE + i)] * left[i];
        total -= rs_square(left[j]) / own;
        part *= own / drawn[j];
        if (j % 2 == 0) { /* an order */
            total -= RS_MATH(log)(part);
            part = 1;
        }
    }
    return total / 2;
}

/* Put the hypotheses together. */
static inline void rs_mix(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    rs_real same = 0, near = 1 - m->row_same, other;
    int j, k;
    for (k = 0; k < RS_FILTERS; k += 2) {
        const rs_real ratio = m->row_evidence * rs_same(&s->filters[k]);
        same += m->row_same * rs_share(s, k) * RS_MATH(exp)(rs_within(ratio, m->row_certain));
    }
    other = RS_MATH(exp)(s->other);
    s->weights[0] = near / (same + near + other);
    s->weights[1] = other / (same + near + other);
    s->counts[0] = s->weights[0];
    s->counts[1] = rs_square(s->weights[1] / m->row_beforehand);
    s->counts[1] = s->counts[1] > 1 ? 1 : s->counts[1];
    if (s->counts[1] < s->weights[1])
        s->counts[1] = s->weights[1];
    for (j = 0; j < RS_WAVES; j++)
        s->ripples[j] = 0;
    for (k = 0; k < RS_FILTERS; k++) {
        const rs_real part = s->weights[k % 2] * rs_share(s, k);
        for (j = 0; j < RS_WAVES; j++)
            s->ripples[j] += part * rs_expected(&s->filters[k], j);
    }
}

/* Take in a row that slides, by each filter. */
static inline void rs_take(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    const rs_real touching = rs_touching(s), *c = m->wave_mean[1], *drawn = m->wave_variance[1];
    rs_real touched[2];
    int j, k;
    for (k = 0; k < 2; k++) {
        rs_real likely = rs_by_ripple(&s->filters[k], s->row, touching, RS_WAVE);
        const rs_real hung = rs_by_ripple(&s->filters[k + 2], s->row, touching, RS_HUNG);
        likely = rs_counted(&s->hangs[k], likely, hung);
        s->other += k ? likely : -likely;
    }
    s->other = rs_within(s->other, m->row_certain);
    for (k = 1; k < RS_FILTERS; k += 2) {
        const rs_real *beta = &s->filters[k].known.mean[RS_WAVE];
        for (j = 0; j < RS_WAVES; j += 2) {
            if (rs_square(beta[j] - c[j]) + rs_square(beta[j + 1] - c[j + 1])
                > m->row_largest * (drawn[j] + drawn[j + 1])) {
                rs_begin_anew(s, k); /* a force that repeats with the angle */
                break;
            }
        }
    }
    for (k = 0; k < 2; k++) {
        const rs_real without = s->filters[k].touched;
        touched[k] = without + s->hangs[k] * (s->filters[k + 2].touched - without);
    }
    if (touched[0] > m->row_recognised && touched[1] > m->row_recognised)
        s->other = s->proven;
    else
        s->proven += rs_within(s->other - s->proven, m->row_ends);
    for (k = 0; k < RS_FILTERS; k++)
        rs_take_back(&s->filters[k]);
}

/* Go on to the end of a row. */
static inline void rs_pass_time(struct rigtool_sensor *s, int slides)
{
    const struct rs_model *m = &rs_model;
    const rs_real kept = slides ? m->row_kept : (rs_real)0;
    const rs_real fresh = (1 - kept * kept) * m->row_untouched;
    int i, j;
    s->fast += m->row_changes * ((rs_real)0.5 - s->fast);
    for (i = 0; i < 2; i++) {
        s->level_variance[i] += m->row_walk[i];
        if (!slides)
            s->level_variance[i] += m->row_reversal; /* friction may be off by a stroke's own */
    }
    for (i = 0; i < RS_FILTERS; i++) {
        struct rs_filter *h = &s->filters[i];
        h->touched += m->row_begins - (m->row_begins + m->row_ends) * h->touched;
        h->known.mean[0] *= kept;
        h->known.shift[0] *= kept;
        for (j = 1; j < RS_PARTS; j++)
            h->known.u[RS_AT(0, j)] *= kept;
        h->known.d[0] = kept * kept * h->known.d[0] + fresh;
    }
    if (slides) { /* at rest nothing makes ripple and what lasts less known */
        const int filter = s->doubted % RS_FILTERS, wave = s->doubted / RS_FILTERS;
        for (i = 0; i < 2; i++)
            s->filters[i].known.lasting[1] += m->row_drift;
        rs_doubt(&s->filters[filter].known, wave, m->wave_doubt[filter % 2][wave]);
        s->doubted = s->doubted + 1 < RS_FILTERS * RS_WAVES ? s->doubted + 1 : 0;
    }
}

/* Advance by a step the waves as the filter's torque shows them: shown_ripple.py. */
static inline void rs_show(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    const rs_real speed = s->x[RS_SPEED], bristle = s->x[RS_HOUSING];
    const rs_real by_sine = bristle * s->sine, by_cosine = bristle * s->cosine;
    const rs_real path = RS_MATH(fabs)(speed) * m->step_time / m->housing_presliding_angle;
    const rs_real left = rs_exp(-path), size = m->step_time / m->housing_presliding_angle;
    const rs_real bent = (speed > 0 ? 1 - bristle : 1 + bristle) * left * size;
    const rs_real root =
        RS_MATH(sqrt)(rs_square(s->x[RS_TORQUE]) + rs_square(m->load_friction_onset));
    const rs_real carried = 1 + m->load_friction * bristle * s->x[RS_TORQUE] / root;
    const rs_real by_torque = s->gain[RS_TORQUE] / m->torque_factor;
    const rs_real by_angle = 1 - s->gain[RS_ANGLE], by_speed = s->gain[RS_SPEED];
    const rs_real by_housing = s->gain[RS_HOUSING];
    const rs_real to_sine = s->gain[RS_SINE], to_cosine = s->gain[RS_COSINE];
    const int held = RS_MATH(fabs)(speed) < m->wave_slow;
    const int begins = bristle * s->stroke < (rs_real)-0.5;
    struct rs_shown *taken = &s->shown[RS_WAVES]; /* a sum of the others: lost where one is */
    rs_real before;
    int j, lost = 0;
    if (begins) {
        s->stroke = bristle > 0 ? (rs_real)1 : (rs_real)-1;
        for (j = 0; j <= RS_WAVES; j++)
            s->shown[j].sine = s->shown[j].cosine = 0;
    }
    for (j = 0; j <= RS_WAVES; j++) {
        struct rs_shown w = s->shown[j];
        rs_real torque;
        before = w.seen;
        torque = carried * w.seen + by_sine * w.sine + by_cosine * w.cosine - s->waves[j]
            - m->housing_friction * w.housing;
        w.housing = left * w.housing + bent * w.speed;
        w.speed += m->wave_turn * torque;
        w.angle += m->step_time * w.speed;
        w.speed -= by_speed * w.angle;
        w.housing -= by_housing * w.angle;
        w.sine += to_sine * w.angle;
        w.cosine += to_cosine * w.angle;
        w.seen += by_torque * w.angle;
        w.angle *= by_angle;
        if (held || RS_MATH(fabs)(w.seen) > m->wave_held) {
            w.angle = w.speed = w.housing = 0;
            w.seen = before + m->wave_shown * (s->waves[j] - before);
            lost = 1;
        }
        s->shown[j] = w;
    }
    if (lost) {
        taken->angle = taken->speed = taken->housing = 0;
        taken->seen = before + m->wave_shown * (s->waves[RS_WAVES] - before);
    }
}

/* Sums over orders of the ripple that is not followed, behind the lag at the rotor's speed. */
static inline void rs_renew_unfollowed(struct rigtool_sensor *s)
{
    const rs_real turned = s->x[RS_SPEED] * rs_model.wave_lag;
    int i, j;
    for (j = 0; j <= RS_POWERS; j++)
        s->unfollowed[j] = 0;
    for (i = 0; i < RS_ORDERS; i++) {
        const rs_real behind = 1 / (1 + rs_square((rs_real)(i + 1) * turned));
        for (j = 0; j <= RS_POWERS; j++)
            s->unfollowed[j] += behind * rs_model.wave_unfollowed[i][j];
    }
}

/* Of the current, A, and the torque constant, N m/A: of the samples that a step ends with. */
static inline rs_real rs_mean_current(const struct rigtool_sensor *s)
{
    return (s->current_before + s->current) / 2;
}

static inline rs_real rs_constant(const struct rigtool_sensor *s)
{
    const rs_real warm = (s->temperature_before + s->temperature) / 2;
    return rs_model.constant + rs_model.constant_slope * warm;
}

/* Add a step to the row; a whole row is taken in where all of it slides. The length of the next
 * one is drawn (D. H. Lehmer): no force swings with the rows. */
static inline void rs_row(struct rigtool_sensor *s, const rs_real seen[RS_WAVES])
{
    const struct rs_model *m = &rs_model;
    const rs_real share = (rs_real)1 / (rs_real)s->row_length, felt = m->torque_factor * share;
    const rs_real direction = rs_sign(s->x[RS_SPEED]);
    const rs_real current = rs_mean_current(s), torque = rs_constant(s) * current;
    int j;
    s->row[0] += (s->x[RS_TORQUE] + m->torque_factor * s->shown[RS_WAVES].seen) * share;
    s->row[RS_HUNG] += share * s->cosine;
    s->row[RS_HUNG + 1] += share * s->sine;
    s->row[RS_HUNG + 2] += share;
    s->lagged[0] += (1 - m->wave_kept) * (torque - s->lagged[0]);
    s->lagged[1] += (1 - m->wave_kept) * (torque * RS_MATH(fabs)(current) - s->lagged[1]);
    for (j = 0; j < RS_FOLLOWED; j++) {
        const rs_real *growth = m->wave_growth[j];
        const rs_real grown = felt * (1 + growth[0] * s->lagged[0] + growth[1] * s->lagged[1]);
        s->row[RS_WAVE + 2 * j] += grown * seen[2 * j];
        s->row[RS_WAVE + 2 * j + 1] += grown * seen[2 * j + 1];
    }
    s->row_slid += s->x[RS_HOUSING] * direction >= m->sliding
        && RS_MATH(fabs)(s->x[RS_SPEED]) >= m->slow;
    if (++s->row_steps < s->row_length)
        return;
    rs_pass_time(s, s->row_slid == s->row_length);
    if (s->row_slid == s->row_length)
        rs_take(s);
    rs_mix(s);
    for (j = 0; j < RS_PARTS; j++)
        s->row[j] = 0;
    s->row_steps = s->row_slid = 0;
    s->row_drawn = (RS_DRAW_FACTOR * s->row_drawn + RS_DRAW_ADDED) % RS_DRAW_MODULUS;
    rs_renew_unfollowed(s);
    s->row_length = RS_ROW_STEPS / 2 + RS_ROW_STEPS * s->row_drawn / RS_DRAW_MODULUS;
}

/* The variance of all ripple: that of what is followed, which has grown with the current as the
 * ripple has, and that of another power-up's that is not. */
static inline rs_real rs_rippling(const struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    const rs_real current = rs_mean_current(s), size = RS_MATH(fabs)(current);
    const rs_real *u = s->unfollowed, growing = rs_square(rs_constant(s) * current)
        * (u[1] + size * (u[2] + size * u[3]));
    const rs_real grown = m->wave_square > 0 ? RS_MATH(sqrt)(growing / m->wave_square) : (rs_real)0;
    return s->ripple_spread * (1 + 2 * grown) + s->counts[1] * (u[0] + growing);
}

/* Renew now and then by what is known what each wave takes off the drive torque. */
static inline void rs_hold(struct rigtool_sensor *s)
{
    int j;
    if (++s->held_steps < RS_HELD_STEPS)
        return;
    s->held_steps = 0;
    for (j = 0; j < RS_WAVES && s->other != 0; j++) /* before a row, nothing */
        s->held[j] = s->ripples[j];
}

/* The variance of what ripple adds to the torque, whose mean is that at the motor. */
static inline rs_real rs_ripple_spread(
    const struct rigtool_sensor *s, const rs_real seen[RS_WAVES], rs_real mean)
{
    rs_real total = (1 - s->weights[0] - s->weights[1]) * rs_square(mean);
    int i, j, k;
    for (k = 0; k < RS_FILTERS; k++) {
        const struct rs_filter *h = &s->filters[k];
        const rs_real lasts = h->lasts, lasting = h->known.lasting[0];
        rs_real own = 0, shift = 0, spread = 0;
        RS_UNROLL
        for (j = 0; j < RS_WAVES; j++) {
            rs_real by = seen[j];
            for (i = 0; i < j; i++)
                by += h->known.u[RS_AT(RS_WAVE + i, RS_WAVE + j)] * seen[i];
            spread += by * by * h->known.d[RS_WAVE + j];
            own += seen[j] * h->known.mean[RS_WAVE + j];
            shift += seen[j] * h->known.shift[RS_WAVE + j];
        }
        spread += rs_square(shift) * lasts * (h->known.lasting[1] + (1 - lasts) * lasting * lasting);
        own += lasts * lasting * shift - mean;
        total += s->counts[k % 2] * rs_share(s, k) * (spread + rs_square(own));
    }
    return rs_square(rs_model.torque_factor) * total;
}

/* What ripple adds to the torque behind the low-pass, less what was taken off the drive torque;
 * *variance receives its variance. */
static inline rs_real rs_rippled(struct rigtool_sensor *s, rs_real *variance)
{
    const struct rs_model *m = &rs_model;
    const rs_real *c = m->low_pass[RS_ORDER];
    rs_real mean = 0, ripple, left, taken = 0;
    rs_real q[RS_ORDER], seen[RS_WAVES];
    int i, j;
    rs_wave(s);
    s->waves[RS_WAVES] = s->taken;
    rs_show(s);
    for (j = 0; j < RS_WAVES; j++)
        seen[j] = s->shown[j].seen;
    rs_row(s, seen);
    rs_hold(s);
    RS_UNROLL
    for (j = 0; j < RS_WAVES; j++) {
        mean += seen[j] * s->ripples[j];
        taken += s->held[j] * s->waves[j];
    }
    s->taken = taken;
    if (s->row_steps % RS_SPREAD_STEPS == 0) /* waves hardly change within that */
        s->ripple_spread = rs_ripple_spread(s, seen, mean);
    *variance = rs_rippling(s);
    left = m->torque_factor * (mean - s->shown[RS_WAVES].seen);
    ripple = c[RS_ORDER] * left;
    for (i = 0; i < RS_ORDER; i++) {
        ripple += c[i] * s->ripple_q[i];
        q[i] = m->low_pass[i][RS_ORDER] * left;
        for (j = 0; j < RS_ORDER; j++)
            q[i] += m->low_pass[i][j] * s->ripple_q[j];
    }
    for (i = 0; i < RS_ORDER; i++)
        s->ripple_q[i] = q[i];
    return ripple;
}

/* -- states and the reading -------------------------------------------------------------------- */

/* For how many steps the encoder has passed one edge at most, this one included. */
static inline int rs_still_steps(struct rigtool_sensor *s, int32_t moved)
{
    int up = s->still_up, down = s->still_down; /* at this count or one above, one below */
    s->still_up = moved == 0 ? up : moved == -1 ? down : 0;
    s->still_down = moved == 0 ? down : moved == 1 ? up : 0;
    if (s->still_up < RS_STILL_STEPS)
        s->still_up++;
    if (s->still_down < RS_STILL_STEPS)
        s->still_down++;
    return s->still_up > s->still_down ? s->still_up : s->still_down;
}

/* Whether angle, mean speed, torque or temperature is beyond what was learned; notes slow ones. */
static inline int rs_outside(
    struct rigtool_sensor *s, rs_real torque, int32_t oldest, int steps)
{
    const struct rs_model *m = &rs_model;
    rs_real way = (rs_real)rs_from(s->encoder, oldest) * m->count;
    rs_real time = (rs_real)steps * m->step_time;
    rs_real warm = (s->temperature_before + s->temperature) / 2;
    s->creeps = RS_MATH(fabs)(way) < m->slow * time;
    s->crawls = s->idle && RS_MATH(fabs)(way) < m->crawling * time;
    return s->encoder < m->lowest || s->encoder > m->highest
        || RS_MATH(fabs)(way) > m->speed_limit * time
        || RS_MATH(fabs)(torque) > m->torque_limit || warm < m->cold || warm > m->warm;
}

/* The state of the step that ends with this count. */
static inline enum rigtool_sensor_state rs_state(struct rigtool_sensor *s, rs_real torque)
{
    const int full = s->steps >= RS_SPEED_STEPS, last = s->next ? s->next - 1 : RS_SPEED_STEPS - 1;
    const int32_t before = s->steps ? s->history[last] : s->encoder;
    const int32_t oldest = full ? s->history[s->next] : s->steps ? s->history[0] : s->encoder;
    const int outside = rs_outside(s, torque, oldest, s->steps ? s->steps : 1);
    const int still = rs_still_steps(s, rs_from(s->encoder, before)) >= RS_STILL_STEPS;
    const rs_real direction = rs_sign(s->x[RS_SPEED]);
    s->history[s->next] = s->encoder;
    s->next = s->next + 1 < RS_SPEED_STEPS ? s->next + 1 : 0;
    s->steps += !full;
    if (s->limited || s->limited_before)
        s->limit_left = RS_LIMIT_STEPS;
    else if (s->limit_left > 0)
        s->limit_left--;
    if (s->limit_left > 0 || outside)
        return RIGTOOL_SENSOR_OUTSIDE;
    if (still)
        return RIGTOOL_SENSOR_STILL;
    if (s->x[RS_HOUSING] * direction < rs_model.sliding)
        return RIGTOOL_SENSOR_REVERSED;
    return torque * direction >= 0 ? RIGTOOL_SENSOR_AGAINST : RIGTOOL_SENSOR_WITH;
}

/* Counts from one to another in the direction of the stroke. */
static inline int32_t rs_along(const struct rigtool_sensor *s, int32_t to, int32_t from)
{
    return s->side > 0 ? rs_from(to, from) : rs_from(from, to);
}

/* What the bristle lacks of being bent where the rotor swings while it creeps, else 0. */
static inline rs_real rs_unbent(struct rigtool_sensor *s, int still)
{
    const struct rs_model *m = &rs_model;
    const rs_real bristle = s->x[RS_HOUSING];
    const int turns = bristle * s->side < (rs_real)-0.5 || s->rested < 0;
    rs_real lacks;
    int32_t way;
    if (bristle * s->side < (rs_real)-0.5)
        s->side = -s->side;
    lacks = 1 - s->side * bristle;
    if (s->rested < 0 || !still)
        s->rested = 0;
    s->rested += still && s->rested < RS_RESTED_STEPS;
    way = rs_along(s, s->encoder, s->farthest);
    if (turns || way < -1 || s->rested == RS_RESTED_STEPS) {
        s->turned = s->farthest = s->encoder;
        s->lacked = lacks;
        s->swung = 0;
    } else if (way > 0) { /* it goes on: where it stays, it may turn */
        s->farthest = s->encoder;
        way = rs_along(s, s->encoder, s->turned);
        if (!(lacks > 1 - m->sliding)
            || !(lacks > m->creep_more * s->lacked
                     * rs_exp((rs_real)(1 - way) * m->count / m->housing_presliding_angle)))
            s->swung = 0;
        else if (s->swung == 0)
            s->swung = 1;
    }
    if (s->swung > 0 && s->swung <= RS_SWUNG_STEPS)
        s->swung++;
    return s->swung > RS_SWUNG_STEPS ? lacks : (rs_real)0;
}

/* The variance of a torque that swings, as it was where the rotor slid last. */
static inline rs_real rs_swing(
    struct rigtool_sensor *s, rs_real torque, enum rigtool_sensor_state state)
{
    const struct rs_model *m = &rs_model;
    const rs_real away = torque - s->level_torque;
    s->level_torque = torque - m->level_kept * away;
    if (state <= RIGTOOL_SENSOR_WITH) {
        const rs_real swing = s->swing * (away * away > s->swing ? m->swing_grows : m->swing_falls);
        s->swing = swing > m->least_swing ? swing : m->least_swing;
    }
    return s->swing - m->least_swing;
}

/* Whether there are numbers to read: currents beyond all limits end them. */
static inline int rs_read(struct rigtool_sensor *s)
{
    const rs_real *c = rs_model.low_pass[RS_ORDER], d = c[RS_ORDER];
    rs_real torque = d * s->x[RS_TORQUE], variance = d * d * rs_variance(s, RS_TORQUE), half, other;
    rs_real unbent, swing, shown;
    struct rigtool_sensor_reading *now = &s->reading;
    const rs_real *scales;
    int i, j;
    for (i = 0; i < RS_ORDER; i++) {
        torque += c[i] * s->q[i];
        variance += 2 * d * c[i] * s->u[RS_TORQUE][RS_STATES + i];
        for (j = 0; j <= i; j++)
            variance += (i == j ? 1 : 2) * c[i] * c[j] * s->own[i][j];
    }
    torque -= rs_rippled(s, &other);
    variance = variance > 0 ? variance : 0;
    if (!rs_finite(torque + variance + other))
        return 0;
    now->fresh = 1;
    now->state = rs_state(s, torque);
    unbent = rs_unbent(s, now->state == RIGTOOL_SENSOR_STILL);
    if (now->state == RIGTOOL_SENSOR_OUTSIDE) {
        now->torque = now->u = now->low = now->high = (rs_real)NAN;
        return 1;
    }
    now->torque = torque;
    swing = rs_swing(s, torque, now->state);
    other += rs_model.swing_taken * swing;
    if (now->state == RIGTOOL_SENSOR_STILL)
        other += rs_model.rest_variance;
    i = now->state <= RIGTOOL_SENSOR_WITH && s->creeps ? RS_CREEPING : (int)now->state;
    scales = rs_model.scales[i];
    shown = rs_square(torque / rs_model.coverage);
    if (shown > rs_model.shown_variance * variance)
        shown = rs_model.shown_variance * variance;
    /* where a load has raised the noise, the deviation holds no more than is needed */
    if ((s->step_left == 0 && s->slow_left == 0) || scales[0] > 1)
        variance *= rs_square(scales[0]);
    if (variance < shown)
        variance = shown;
    if (s->idle && variance < rs_model.open_variances[s->crawls][i])
        variance = rs_model.open_variances[s->crawls][i];
    if (!s->idle && s->rested_up >= RS_UNSEEN_STEPS && s->rested_down >= RS_UNSEEN_STEPS
        && variance < rs_model.held_variance)
        variance = rs_model.held_variance;
    unbent *= rs_model.creep_variance * unbent;
    if (variance < unbent)
        variance = unbent;
    if (now->state > RIGTOOL_SENSOR_WITH && (s->creeps || now->state == RIGTOOL_SENSOR_STILL)) {
        swing = swing < rs_model.held_variance ? swing : rs_model.held_variance;
        variance = variance < swing ? swing : variance;
    }
    now->u = RS_MATH(sqrt)(variance + rs_square(scales[1] * torque) + other);
    half = rs_model.coverage * now->u;
    now->low = torque - half;
    now->high = torque + half;
    return 1;
}

/* -- the interface ----------------------------------------------------------------------------- */

/* Begin anew, but for what lies behind some bytes. */
static inline void rs_anew(struct rigtool_sensor *s, size_t bytes)
{
    memset(s, 0, bytes);
    s->limit_left = RS_LIMIT_STEPS + 1; /* until the filter has found the motion */
    s->reading.torque = s->reading.u = s->reading.low = s->reading.high = (rs_real)NAN;
}

/* Begin, or begin anew: nothing is known of what was before. */
static inline void rigtool_sensor_init(struct rigtool_sensor *s)
{
    rs_anew(s, sizeof *s);
}

/* Samples are missing before the next one: until the power is cut, ripple stays what it is. */
static inline void rigtool_sensor_gap(struct rigtool_sensor *s)
{
    rs_anew(s, offsetof(struct rigtool_sensor, lost));
}

/* Expect of what acts, and of a stroke, what is expected before any row. */
static inline void rs_no_load(struct rs_ripple *known, int filter)
{
    const struct rs_model *m = &rs_model;
    int i, j;
    for (i = 0; i < RS_WAVE; i++) {
        known->mean[i] = 0;
        known->d[i] = i < RS_HUNG ? m->row_untouched
            : filter > 1 ? m->row_hanging[i - RS_HUNG] : (rs_real)0;
        for (j = i + 1; j < RS_PARTS; j++)
            known->u[RS_AT(i, j)] = 0;
    }
    memset(known->shift, 0, sizeof known->shift);
    known->lasting[0] = 0;
    known->lasting[1] = m->row_lasting;
}

/* Know of the ripple what is known before any row; behind a gap, what was known before it. */
static inline void rs_begin_ripple(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    int j;
    s->level_variance[0] = s->level_variance[1] = m->row_contact;
    for (j = 0; j < RS_FILTERS; j++) {
        struct rs_filter *h = &s->filters[j];
        if (!s->followed) {
            rs_unknown(&h->known, j);
            h->before[0] = h->before[1] = h->known;
        }
        rs_no_load(&h->known, j);
        rs_no_load(&h->before[0], j);
        rs_no_load(&h->before[1], j);
        h->lasts = j < 2 ? m->row_lasts : (rs_real)0;
        s->hangs[j % 2] = m->row_hangs;
    }
    if (s->followed)
        return;
    s->followed = 1;
    s->row_length = RS_ROW_STEPS;
    rs_mix(s);
    rs_renew_unfollowed(s);
}

/* The shaft rests somewhere within its count; the tendon is stretched by what acts on the output,
 * almost, as the tip's friction holds it. */
static inline void rs_begin(struct rigtool_sensor *s)
{
    const struct rs_model *m = &rs_model;
    const rs_real stretch = m->torque_start / m->stiffness, held = (rs_real)0.999;
    int i, j;
    rs_rebase(s, s->encoder);
    for (i = 0; i < RS_STATES; i++) {
        s->x[i] = 0;
        s->u[i][i] = 1;
        s->d[i] = rs_square(m->bristle_start);
    }
    s->x[RS_ANGLE] = m->count / 2;
    s->x[RS_GRASPER] = m->count / 2 / m->angle_ratio;
    s->d[RS_ANGLE] = rs_square(m->count / 2);
    s->d[RS_SPEED] = s->d[RS_GRASPER_SPEED] = rs_square(m->speed_start);
    s->d[RS_GRASPER] = rs_square(stretch) * (1 - held * held);
    s->d[RS_TORQUE] = rs_square(m->torque_start);
    s->u[RS_GRASPER][RS_TORQUE] = -held / m->stiffness;
    for (i = 0; i < RS_ORDER; i++) { /* the torque has always been behind the low-pass */
        const rs_real shared = m->settled[i] * s->d[RS_TORQUE];
        s->u[RS_TORQUE][RS_STATES + i] = shared;
        s->u[RS_GRASPER][RS_STATES + i] = -held / m->stiffness * shared;
        for (j = 0; j < RS_ORDER; j++)
            s->own[i][j] = shared * m->settled[j];
    }
    s->counted = s->encoder;
    s->none_steps = RS_IDLE_STEPS; /* as if it had been so before */
    s->d[RS_NOISE] = rs_square(m->friction_noise);
    s->d[RS_SINE] = s->d[RS_COSINE] = rs_square(m->stroke);
    s->d[RS_LOAD] = rs_square(m->load_stroke);
    s->direction = s->stroke = s->side = 1;
    s->rested = -1; /* nowhere yet */
    s->swing = m->least_swing;
    rs_begin_ripple(s);
    s->still_up = s->still_down = RS_STILL_STEPS;
    rs_locate(s);
    rs_ahead(s);
    s->begun = 1;
}

/* Take the signals half a sample earlier, where an odd number of samples makes one of the
 * equations: the count is in the middle then. */
static inline void rs_earlier(
    struct rigtool_sensor *s, struct rigtool_sensor_sample *sample, int *limited)
{
    const struct rigtool_sensor_sample own = *sample;
    const int at_limit = *limited;
    if (s->heard) {
        sample->current = (own.current + s->last.current) / 2;
        sample->temperature = (own.temperature + s->last.temperature) / 2;
        *limited |= s->last_limited;
    }
    s->last = own;
    s->last_limited = at_limit;
    s->heard = 1;
}

/* Whether no rotor moves by that from one sample to the next. */
static inline int rs_leaps(int32_t counts)
{
    return (uint32_t)counts + RS_LEAP > 2u * RS_LEAP;
}

/* Put back what a count leaps by; whether it came after a rest instead, in which the encoder may
 * have stopped: experiments/force_filter/lost_counts.py. */
static inline int rs_put_back(struct rigtool_sensor *s, int32_t read)
{
    const int32_t step = rs_from(read, s->read), more = rs_from(step, s->usual);
    int32_t leap = more;
    int wrapped = 0, bit;
    s->read = read;
    s->unchanged += s->unchanged <= RS_COUNTING_SAMPLES;
    if (s->reads < 2 || !rs_leaps(step) || !rs_leaps(more)) {
        if (step != 0 || s->reads == 0)
            s->unchanged = 0;
        s->usual = step;
        s->reads += s->reads < 2;
        return 0;
    }
    for (bit = 14; bit < 31; bit++) { /* where counters wrap: at a turn, or 2^15 and more */
        const int32_t wraps = bit == 14 ? rs_model.turn : (int32_t)1 << bit;
        const int32_t signed_wraps = more < 0 ? -wraps : wraps;
        if (wraps / 4 < RS_LEAP || rs_leaps(rs_from(more, signed_wraps)))
            continue;
        leap = signed_wraps;
        wrapped = 1;
    }
    if (!wrapped && s->unchanged > RS_COUNTING_SAMPLES)
        return 1;
    s->lost = rs_from(s->lost, rs_from(0, leap));
    return 0;
}

/* Take in a sample of the loop and return the latest reading; where the current is no number, or the
 * temperature is none, or far outside, those before hold, RS_HELD times: then it begins anew. */
static inline const struct rigtool_sensor_reading *rigtool_sensor_update(
    struct rigtool_sensor *s, struct rigtool_sensor_sample sample)
{
    rs_real torque, viscous;
    int limited = !(RS_MATH(fabs)(sample.current) < rs_model.current_limit), none;
#if RS_DIVIDED > 1
    int part;
#endif
    s->reading.fresh = 0;
    if (!(RS_MATH(fabs)(sample.temperature) <= rs_model.farthest)
        || (limited && !rs_finite(sample.current))) {
        if (s->holds == 0) {
            rigtool_sensor_gap(s);
            return &s->reading;
        }
        s->holds--;
        sample.current = s->known.current;
        sample.temperature = s->known.temperature;
        limited = !(RS_MATH(fabs)(sample.current) < rs_model.current_limit);
    } else {
        s->known = sample;
        s->holds = RS_HELD;
    }
    if (rs_put_back(s, sample.encoder))
        rs_anew(s, offsetof(struct rigtool_sensor, known));
    if (s->collected == RS_AVERAGED / 2) /* angles belong to the middle of what is averaged */
        s->encoder = rs_from(sample.encoder, s->lost);
    if (s->collected == 0) {
        s->current = s->temperature = 0;
        s->limited = 0;
    }
    sample.current = rs_within(sample.current, rs_model.largest_current);
    if (RS_AVERAGED % 2)
        rs_earlier(s, &sample, &limited);
    s->current += sample.current;
    s->temperature += sample.temperature;
    s->limited |= limited;
    if (++s->collected < RS_AVERAGED)
        return &s->reading;
    s->collected = 0;
    s->current *= (rs_real)1 / RS_AVERAGED;
    s->temperature *= (rs_real)1 / RS_AVERAGED;
    if (!s->begun)
        rs_begin(s);
    none = RS_MATH(fabs)(s->current) <= rs_model.no_current;
    if (s->samples == RS_STEP_SAMPLES) {
        s->samples = 0;
        if (!none || !s->none_before)
            s->none_steps = 0;
        else if (s->none_steps < RS_IDLE_STEPS)
            s->none_steps++;
        s->idle = s->none_steps == RS_IDLE_STEPS;
        rs_predicted(s);
        rs_rebase(s, s->encoder);
        rs_update(s);
        rs_locate(s);
        if (!rs_read(s)) {
            rigtool_sensor_init(s);
            return &s->reading;
        }
        rs_ahead(s);
    }
    s->samples += RS_DIVIDED;
    torque = rs_drive(s, &viscous);
    rs_advance(s, torque, viscous);
#if RS_DIVIDED > 1 /* then behind the count that was read now */
    s->current = s->last.current;
    s->temperature = s->last.temperature;
    s->limited = s->last_limited;
    none = RS_MATH(fabs)(s->current) <= rs_model.no_current;
    for (part = 1; part < RS_DIVIDED; part++) {
        torque = rs_drive(s, &viscous);
        rs_advance(s, torque, viscous);
    }
#endif
    s->temperature_before = s->temperature;
    s->current_before = s->current;
    s->limited_before = s->limited;
    s->none_before = none;
    return &s->reading;
}

#endif /* RIGTOOL_SENSOR_H */
