/* The loop of a target: what happens at each sample. See rigtool_target.h. */

#include "rigtool_target.h"

#include <math.h>
#include <string.h>

#ifdef RIGTOOL_TARGET_FLOAT
#define RT_MATH(name) name##f
#else
#define RT_MATH(name) name
#endif
#define RT_PI 3.14159265358979323846
#define RT_SETTLE_TIME 0.5
#define RT_MOVE_SPEED 2.0
#define RT_CURRENT_TIME 0.01      /* over which current is averaged, s */
#define RT_CURRENT_TOLERANCE 1.05 /* noise on a current that is held at its limit */

double rt_number(const uint8_t *data, uint32_t index)
{
    double value;
    memcpy(&value, data + 8u * index, 8);
    return value;
}

double rt_position(const struct rigtool_target *t)
{
    return t->reading.encoder * t->count;
}

double rt_time(const struct rigtool_target *t)
{
    return (t->ticks_high * 4294967296.0 + t->ticks_low) * t->config.sample_time;
}

/* --- Motions: the formulas, and the order of operations, of rigtool/rigs/motion.py ------------- */

static int valid(const struct rigtool_target_motion *m)
{
    const double *x = m->number;
    uint32_t i, n = m->count / 2;
    switch (m->kind) {
    case 1:
        if (m->count < 4 || m->count % 2)
            return 0;
        for (i = 1; i < n; i++)
            if (!(rt_number(m->data, i) > rt_number(m->data, i - 1)))
                return 0;
        return rt_number(m->data, 0) == 0.0;
    case 2:
        return m->count == 5 && x[2] > 0 && x[3] > 0 && x[4] >= 1 && x[4] <= 1e6 &&
               x[1] - x[0] >= 2 * x[3];
    case 3:
        return m->count == 2 && x[1] > 0;
    case 4:
        return m->count >= 2 && x[0] > 0;
    case 5:
        return m->count == 2 && x[0] != 0;
    }
    return 0;
}

/* Read a motion; 0 where it cannot be followed. */
int rt_motion(struct rigtool_target_motion *m, const uint8_t *data, uint32_t size)
{
    uint32_t i;
    memset(m, 0, sizeof *m);
    if (size < 1 || (size - 1) % 8)
        return 0;
    m->kind = data[0];
    m->data = data + 1;
    m->count = (size - 1) / 8;
    for (i = 0; i < m->count && i < 5; i++)
        m->number[i] = rt_number(m->data, i);
    if (!valid(m))
        return 0;
    if (m->kind == 2) {
        m->turn = 2 * m->number[3] / m->number[2];
        m->stroke = (m->number[1] - m->number[0] - 2 * m->number[3]) / m->number[2] + 2 * m->turn;
    }
    return 1;
}

double rt_duration(const struct rigtool_target_motion *m)
{
    switch (m->kind) {
    case 1:
        return rt_number(m->data, m->count / 2 - 1);
    case 2:
        return 2 * floor(m->number[4]) * m->stroke;
    case 3:
        return m->number[1];
    case 4:
        return (m->count - 1) * m->number[0];
    case 5:
        return fabs(m->number[1] / m->number[0]);
    }
    return 0.0;
}

void rt_move(struct rigtool_target_motion *m, double angle, double duration)
{
    memset(m, 0, sizeof *m);
    m->kind = 3;
    m->number[0] = angle;
    m->number[1] = duration;
}

static void profile(struct rigtool_target_motion *m, double time, double out[3])
{
    uint32_t n = m->count / 2;
    const uint8_t *speeds = m->data + 8u * n;
    double step, elapsed, low, slope;
    for (;;) {
        low = rt_number(speeds, m->piece);
        step = rt_number(m->data, m->piece + 1) - rt_number(m->data, m->piece);
        if (m->piece + 2 >= n || time < rt_number(m->data, m->piece + 1))
            break;
        m->travelled += step * (rt_number(speeds, m->piece + 1) + low) / 2;
        m->piece++;
    }
    slope = (rt_number(speeds, m->piece + 1) - low) / step;
    elapsed = time - rt_number(m->data, m->piece);
    out[0] = m->travelled + (low + slope * elapsed / 2) * elapsed;
    out[1] = low + slope * elapsed;
    out[2] = slope;
}

static void triangle(struct rigtool_target_motion *m, double time, double out[3])
{
    double middle = (m->number[1] - m->number[0]) / 2, v = m->number[2], half = m->stroke / 2;
    double late, travelled;
    int falling;
    while (time >= (m->piece + 1) * m->stroke)
        m->piece++;
    falling = m->piece % 2;
    late = time - m->piece * m->stroke - half;
    travelled = v * late;
    out[1] = v;
    out[2] = 0.0;
    if (fabs(late) > half - m->turn) {
        double end = late > 0 ? 1.0 : -1.0, phase = RT_PI / m->turn * (half - fabs(late));
        rigtool_real sine = RT_MATH(sin)((rigtool_real)phase);
        travelled = end * (middle - v * m->turn / (2 * RT_PI) * (phase - sine));
        out[1] = v * (1 - RT_MATH(cos)((rigtool_real)phase)) / 2;
        out[2] = -end * v * RT_PI / (2 * m->turn) * sine;
    }
    out[0] = falling ? middle - travelled : middle + travelled;
    out[1] = falling ? -out[1] : out[1];
    out[2] = falling ? -out[2] : out[2];
}

static void move(const struct rigtool_target_motion *m, double time, double out[3])
{
    double angle = m->number[0], duration = m->number[1];
    double s = time / duration, left;
    s = s < 0 ? 0 : s > 1 ? 1 : s;
    left = 1 - s;
    out[0] = angle * (s * s * s) * (10 - 15 * s + 6 * (s * s));
    out[1] = angle / duration * 30 * (s * s) * (left * left);
    out[2] = angle / (duration * duration) * 60 * s * left * (1 - 2 * s);
}

static double open_current(const struct rigtool_target_motion *m, double time)
{
    uint32_t step, last = m->count - 2;
    if (m->kind == 5)
        return m->number[0] * time;
    step = (uint32_t)floor(time / m->number[0] + 1e-9);
    return rt_number(m->data, 1 + (step > last ? last : step));
}

/* --- The learned table: bilinear, and amplitude times the lowest row below it ------------------ */

/* Read a table, or none where the size is 0; 0 where it is none. */
int rt_table(struct rigtool_target *t, const uint8_t *data, uint32_t size)
{
    uint32_t n, m, k, i, negative = 0, positive;
    t->table = 0;
    if (size == 0)
        return 1;
    if (size < 12)
        return 0;
    memcpy(&n, data, 4);
    memcpy(&m, data + 4, 4);
    memcpy(&k, data + 8, 4);
    if (n < 2 || m < 1 || k < 2 || n > size || m > size || k > size ||
        (uint64_t)8 * (n + m + 2 * k + (uint64_t)n * m) != size - 12)
        return 0;
    data += 12;
    for (i = 1; i < n; i++)
        if (!(rt_number(data, i) > rt_number(data, i - 1)))
            return 0;
    for (i = 0; i < m; i++) {
        double speed = rt_number(data, n + i);
        if (speed == 0 || (i && !(speed > rt_number(data, n + i - 1))))
            return 0;
        negative += speed < 0;
    }
    for (i = 1; i < k; i++)
        if (!(rt_number(data, n + m + i) > rt_number(data, n + m + i - 1)))
            return 0;
    positive = m - negative;
    t->table_columns = n;
    t->table_rows = m;
    t->table_low = k;
    t->table_negative = negative;
    t->table_lines = m + 1 + (negative ? k - 2 : 0) + (positive ? k - 2 : 0);
    t->table_start = rt_number(data, 0);
    t->table_step = (rt_number(data, n - 1) - t->table_start) / (n - 1);
    memset(&t->lines, 0, sizeof t->lines);
    t->table = data;
    return 1;
}

/* Give speed, row (-1: zero) and factor of one of the lines, in the order of their speeds. */
static double line_speed(const struct rigtool_target *t, uint32_t line, int32_t *row, double *factor)
{
    const uint8_t *speeds = t->table + 8u * t->table_columns;
    const uint8_t *low = speeds + 8u * t->table_rows, *amplitude = low + 8u * t->table_low;
    uint32_t negative = t->table_negative, between = t->table_low - 2, zero;
    zero = negative ? negative + between : 0;
    *factor = 1.0;
    if (line < negative) {
        *row = (int32_t)line;
        return rt_number(speeds, line);
    }
    if (line < zero) {
        *row = (int32_t)negative - 1;
        *factor = rt_number(amplitude, between - (line - negative));
        return -rt_number(low, between - (line - negative));
    }
    if (line == zero) {
        *row = -1;
        return 0.0;
    }
    line -= zero;
    if (t->table_rows > negative && line <= between) {
        *row = (int32_t)negative;
        *factor = rt_number(amplitude, line);
        return rt_number(low, line);
    }
    *row = (int32_t)(negative + line - between - 1);
    return rt_number(speeds, (uint32_t)*row);
}

/* Find the lines on either side of a speed; most samples stay between those of the last one. */
static void find_line(struct rigtool_target *t, rigtool_real speed)
{
    struct rigtool_target_lines *l = &t->lines;
    uint32_t line = l->line;
    int32_t row;
    double factor, low, high;
    if (l->valid && speed >= l->low && speed < l->high)
        return;
    while (line > 0 && speed < line_speed(t, line, &row, &factor))
        line--;
    while (line + 2 < t->table_lines && speed >= line_speed(t, line + 1, &row, &factor))
        line++;
    low = line_speed(t, line, &l->row[0], &factor);
    l->factor[0] = (rigtool_real)factor;
    high = line_speed(t, line + 1, &l->row[1], &factor);
    l->factor[1] = (rigtool_real)factor;
    l->low = (rigtool_real)low;
    l->high = (rigtool_real)high;
    l->slope = (rigtool_real)(1.0 / (high - low));
    l->line = line;
    l->valid = 1;
}

static rigtool_real entry(const struct rigtool_target *t, int side, uint32_t column)
{
    const uint8_t *torque = t->table + 8u * (t->table_columns + t->table_rows + 2 * t->table_low);
    int32_t row = t->lines.row[side];
    if (row < 0)
        return 0;
    return t->lines.factor[side] *
           (rigtool_real)rt_number(torque, (uint32_t)row * t->table_columns + column);
}

rigtool_real rt_table_torque(struct rigtool_target *t, double position, double at_speed)
{
    uint32_t last = t->table_columns - 1, column;
    rigtool_real place = (rigtool_real)(position - t->table_start) / (rigtool_real)t->table_step;
    rigtool_real across, along, lower, upper, left, speed = (rigtool_real)at_speed;
    const struct rigtool_target_lines *l = &t->lines;
    place = place > 0 ? (place < (rigtool_real)last ? place : (rigtool_real)last) : 0;
    column = (uint32_t)place;
    column = column > last - 1 ? last - 1 : column;
    across = place - (rigtool_real)column;
    find_line(t, speed);
    if (speed <= l->low)
        along = 0;
    else if (speed >= l->high)
        along = 1;
    else
        along = (l->slope * (speed - l->low) + (rigtool_real)l->line) - (rigtool_real)l->line;
    left = entry(t, 0, column);
    lower = left + across * (entry(t, 0, column + 1) - left);
    left = entry(t, 1, column);
    upper = left + across * (entry(t, 1, column + 1) - left);
    return lower + (upper - lower) * along;
}

/* --- Starting and stopping ---------------------------------------------------------------------- */

static int32_t in_counts(double value);

/* Begin the motion that is armed, or the move alone; the approach comes first. */
void rt_begin(struct rigtool_target *t)
{
    double speed = 0.4 * t->limits[1], way = 0.0, dt = t->config.sample_time;
    int open_loop = t->motion.kind > 3 && !t->moving_only;
    if (open_loop) {
        t->closed = 0;
    } else if (!t->closed) {
        memset(t->section_state, 0, sizeof t->section_state);
        t->setpoint = rt_position(t);
        t->closed = 1;
    }
    if (t->moving_only)
        way = t->motion.number[0];
    else if (t->motion.kind == 2)
        way = t->motion.number[0] - t->setpoint;
    speed = speed < RT_MOVE_SPEED ? speed : RT_MOVE_SPEED;
    rt_move(&t->approach, way, RT_SETTLE_TIME + fabs(way) / speed);
    rt_move(&t->settle, 0.0, RT_SETTLE_TIME);
    t->approach.steps = (uint32_t)floor(rt_duration(&t->approach) / dt + 0.5);
    t->settle.steps = (uint32_t)floor(rt_duration(&t->settle) / dt + 0.5);
    t->approach.origin = t->setpoint;
    t->phase = t->moving_only || t->motion.kind == 2 ? 0 : 2;
    t->motion.step = t->motion.piece = 0;
    t->motion.travelled = 0.0;
    t->motion.origin = t->motion.kind == 2 ? t->motion.number[0] : t->setpoint;
    t->begin = rt_position(t);
    t->signal_at = t->summed = t->recorded = t->sent = 0;
    t->ring_filled = t->current_samples = 0;
    t->current_sum = 0;
    t->most_moved = in_counts(t->limits[1] * RIGTOOL_TARGET_RING * dt / t->count);
    t->lowest = in_counts(ceil(t->limits[2] / t->count));
    t->highest = in_counts(floor(t->limits[3] / t->count));
    t->hottest = (rigtool_real)t->limits[4];
    t->current_window = (uint32_t)(RT_CURRENT_TIME / dt + 0.5);
    memset(t->sum, 0, sizeof t->sum);
    t->heard = 1;
    t->power = 1;
    t->state = RIGTOOL_TARGET_RUNNING;
}

void rt_stop(struct rigtool_target *t, int state)
{
    t->power = 0;
    t->closed = 0;
    t->state = state;
}

static void trip(struct rigtool_target *t, int why, double value, double limit)
{
    t->trip = why;
    t->trip_value = value;
    t->trip_limit = limit;
    rt_stop(t, RIGTOOL_TARGET_TRIPPED);
}

static void finish(struct rigtool_target *t)
{
    if (t->closed)
        t->state = RIGTOOL_TARGET_DONE;
    else
        rt_stop(t, RIGTOOL_TARGET_DONE);
}

/* --- One sample --------------------------------------------------------------------------------- */

static double controller(struct rigtool_target *t, double u)
{
    int j;
    for (j = 0; j < t->sections; j++) {
        const double *c = t->section[j];
        double *state = t->section_state[j];
        double y = c[0] * u + state[0];
        state[0] = c[1] * u - c[4] * y + state[1];
        state[1] = c[2] * u - c[5] * y;
        u = y;
    }
    return u;
}

/* Trip where a limit is passed. Position and speed are compared in counts. */
static void watch(struct rigtool_target *t)
{
    const struct rigtool_target_reading *now = &t->reading;
    int32_t moved = now->encoder - t->ring[t->ring_at];
    rigtool_real degc = now->degc;
    if (t->ring_filled == RIGTOOL_TARGET_RING) {
        int32_t counts = (moved < 0 ? -moved : moved) - 1;
        if (counts > t->most_moved)
            trip(t, RIGTOOL_TARGET_BY_SPEED,
                 counts * t->count / (RIGTOOL_TARGET_RING * t->config.sample_time), t->limits[1]);
    } else {
        t->ring_filled++;
    }
    t->ring[t->ring_at] = now->encoder;
    t->ring_at = (t->ring_at + 1) % RIGTOOL_TARGET_RING;
    if (now->encoder < t->lowest)
        trip(t, RIGTOOL_TARGET_BY_POSITION, rt_position(t), t->limits[2]);
    if (now->encoder > t->highest)
        trip(t, RIGTOOL_TARGET_BY_POSITION, rt_position(t), t->limits[3]);
    if (degc > t->hottest)
        trip(t, RIGTOOL_TARGET_BY_TEMPERATURE, degc, t->limits[4]);
    t->current_sum += RT_MATH(fabs)(now->current);
    if (++t->current_samples >= t->current_window) {
        rigtool_real mean = t->current_sum / (rigtool_real)t->current_samples;
        if (!(mean <= (rigtool_real)(RT_CURRENT_TOLERANCE * t->limits[0])))
            trip(t, RIGTOOL_TARGET_BY_CURRENT, mean, t->limits[0]);
        t->current_sum = 0;
        t->current_samples = 0;
    }
}

/* A limit in counts, as far as counts reach. */
static int32_t in_counts(double value)
{
    return value < -2147483647.0 ? -2147483647 : value > 2147483647.0 ? 2147483647 : (int32_t)value;
}

/* Append the sums as a sample of the log. */
static void record(struct rigtool_target *t, double degc)
{
    uint8_t *place = t->config.log + (t->recorded % t->capacity) * t->sample_size;
    int channel;
    if (t->recorded - t->sent >= t->capacity) { /* only where streamed samples make room */
        trip(t, RIGTOOL_TARGET_BY_LINE, 0.0, 0.0);
        return;
    }
    for (channel = 0; channel < RIGTOOL_TARGET_CHANNELS; channel++) {
        double value;
        if (!(t->mask >> channel & 1))
            continue;
        value = channel == 8 ? degc : t->every == 1 ? t->sum[channel] : t->sum[channel] / t->every;
        if (channel < 3) {
            memcpy(place, &value, 8);
            place += 8;
        } else {
            float narrow = (float)value;
            memcpy(place, &narrow, 4);
            place += 4;
        }
    }
    memset(t->sum, 0, sizeof t->sum);
    t->summed = 0;
    t->recorded++;
}

/* The motion of this sample; 0 where none runs. */
static struct rigtool_target_motion *now_moving(struct rigtool_target *t)
{
    if (t->state != RIGTOOL_TARGET_RUNNING)
        return 0;
    return t->phase == 0 ? &t->approach : t->phase == 1 ? &t->settle : &t->motion;
}

static void advance(struct rigtool_target *t, struct rigtool_target_motion *m)
{
    if (++m->step < m->steps)
        return;
    if (t->phase == 0)
        t->settle.origin = t->setpoint;
    if (t->phase == 2 || (t->phase == 1 && t->moving_only))
        finish(t);
    else
        t->phase++;
}

static rigtool_real feed_forward(struct rigtool_target *t, const double now[3], rigtool_real part[3])
{
    rigtool_real speed = (rigtool_real)now[1], model;
    model = t->inertia * (rigtool_real)now[2] + t->viscous * speed;
    if (t->coulomb != 0)
        model = model + t->coulomb * RT_MATH(tanh)(speed);
    part[0] = model / t->torque_constant;
    if (t->table)
        part[1] = rt_table_torque(t, now[0], now[1]) / t->torque_constant;
    if (t->signal_size) {
        part[2] = (rigtool_real)rt_number(t->signal, t->signal_at) / t->torque_constant;
        t->signal_at = t->signal_at + 1 < t->signal_size ? t->signal_at + 1 : 0;
    }
    return part[0] + part[1] + part[2];
}

/* Whether the host is silent for too long: then the motor goes off. */
static void guard(struct rigtool_target *t)
{
    uint32_t silence;
    if (t->heard) {
        t->heard = 0;
        t->fed = t->reading.milliseconds;
    }
    silence = t->reading.milliseconds - t->fed;
    if (silence <= t->watchdog_ms || t->watchdog_ms == 0)
        return;
    if (t->state == RIGTOOL_TARGET_RUNNING)
        trip(t, RIGTOOL_TARGET_BY_WATCHDOG, silence * 1e-3, t->watchdog_ms * 1e-3);
    else if (t->state == RIGTOOL_TARGET_DONE || t->state == RIGTOOL_TARGET_ARMED)
        rt_stop(t, RIGTOOL_TARGET_OFF);
}

int rigtool_target_power(const struct rigtool_target *t)
{
    return t->power;
}

static rigtool_real limited(rigtool_real value, rigtool_real limit)
{
    value = value < limit ? value : limit;
    return value > -limit ? value : -limit;
}

rigtool_real rigtool_target_loop(struct rigtool_target *t,
                                 const struct rigtool_target_reading *reading)
{
    struct rigtool_target_motion *m;
    rigtool_real asked = 0, part[3] = {0, 0, 0};
    double now[3] = {0.0, 0.0, 0.0}, time = 0.0;
    int recorded;
    t->reading = *reading;
    m = now_moving(t);
    if (m == &t->motion)
        time = rt_time(t);
    if (++t->ticks_low == 0)
        t->ticks_high++;
    guard(t);
    if (m)
        watch(t);
    if (!t->power)
        m = 0;
    recorded = m == &t->motion;
    if (m && m->kind > 3) {
        asked = (rigtool_real)open_current(m, (m->step + 0.5) * t->config.sample_time);
        t->setpoint = rt_position(t);
    } else if (m) {
        double moment = (m->step + 0.5) * t->config.sample_time;
        if (m->kind == 1)
            profile(m, moment, now);
        else if (m->kind == 2)
            triangle(m, moment, now);
        else
            move(m, moment, now);
        t->setpoint = now[0] = now[0] + m->origin;
    }
    if (t->power && t->closed) {
        double torque = controller(t, t->setpoint - rt_position(t));
        asked = (rigtool_real)torque / t->torque_constant;
        if (recorded)
            asked = asked + feed_forward(t, now, part);
    }
    asked = t->power ? limited(asked, t->limit) : 0;
    if (recorded) {
        double value[RIGTOOL_TARGET_CHANNELS];
        int channel;
        value[0] = time;
        value[1] = t->setpoint;
        value[2] = reading->encoder;
        value[3] = asked;
        value[4] = reading->current;
        value[5] = part[0];
        value[6] = part[1];
        value[7] = part[2];
        for (channel = 0; channel < 8; channel++) {
            if (t->every == 1)
                t->sum[channel] = value[channel];
            else
                t->sum[channel] += value[channel];
        }
        if (++t->summed >= t->every)
            record(t, reading->degc);
        if (m->kind > 3 && fabs(rt_position(t) - t->begin) > t->stop_angle)
            finish(t);
    }
    if (m && t->state == RIGTOOL_TARGET_RUNNING)
        advance(t, m);
    if (t->config.observe) {
        struct rigtool_target_sample sample;
        sample.reading = *reading;
        sample.setpoint = t->setpoint;
        sample.asked = asked;
        t->config.observe(t->config.context, &sample);
    }
    return t->state == RIGTOOL_TARGET_TRIPPED ? 0 : asked;
}
