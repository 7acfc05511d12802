/* The link of a target: frames, requests, objects. See rigtool_target.h and docs/target-link.md. */

#include "rigtool_target.h"

#include <math.h>
#include <string.h>

#define RT_VERSION 1
#define RT_REPLY 0x80
#define RT_REFUSED 0xFF
#define RT_SAMPLES 0x7E
#define RT_HEAD 3     /* bytes before the payload of a frame */
#define RT_STREAMED 64 /* samples of a streamed frame, at most */
#define RT_ABILITIES (1u | 2u | 4u | 8u | 16u)
#define RT_KEEPS_LOG 32u

enum {
    HELLO = 1, BEGIN, CHUNK, COMMIT, ARM, START, STATUS, READ, DIGEST, STOP, MOVE, BYE = 15
};
enum { NO_SESSION = 1, BAD_CRC, NOT_NOW, BAD_VALUE, FAULT };

/* --- Bytes -------------------------------------------------------------------------------------- */

/* A payload that is written: the answer, or streamed samples. */
struct out {
    uint8_t *at;
    uint32_t size;
};

static void put(struct out *o, const void *data, uint32_t size)
{
    if (size > RIGTOOL_TARGET_PAYLOAD - o->size)
        size = RIGTOOL_TARGET_PAYLOAD - o->size;
    memcpy(o->at + o->size, data, size);
    o->size += size;
}

static void put_text(struct out *o, const char *text)
{
    put(o, text, (uint32_t)strlen(text));
}

static void put_u8(struct out *o, uint8_t value)
{
    put(o, &value, 1);
}

static void put_u16(struct out *o, uint16_t value)
{
    put(o, &value, 2);
}

static void put_u32(struct out *o, uint32_t value)
{
    put(o, &value, 4);
}

static void put_f8(struct out *o, double value)
{
    put(o, &value, 8);
}

/* Write a number with three decimals, as far as it is one. */
static void put_number(struct out *o, double value)
{
    char digits[24];
    int at = sizeof digits, decimals = 3;
    uint32_t whole, part;
    if (!(fabs(value) < 4e9)) {
        put_text(o, value > 0 ? "more than 4e9" : value < 0 ? "less than -4e9" : "nan");
        return;
    }
    if (value < 0)
        put_text(o, "-");
    value = fabs(value);
    whole = (uint32_t)value;
    part = (uint32_t)((value - whole) * 1000 + 0.5);
    if (part >= 1000) {
        part = 0;
        whole++;
    }
    if (part) {
        for (; decimals; decimals--) {
            digits[--at] = (char)('0' + part % 10);
            part /= 10;
        }
        digits[--at] = '.';
    }
    do {
        digits[--at] = (char)('0' + whole % 10);
        whole /= 10;
    } while (whole);
    put(o, digits + at, (uint32_t)(sizeof digits - (size_t)at));
}

static uint32_t get_u32(const uint8_t *data)
{
    uint32_t value;
    memcpy(&value, data, 4);
    return value;
}

/* CRC-16/XMODEM, most significant bit first. */
static uint16_t crc16(const uint8_t *data, uint32_t size)
{
    uint16_t crc = 0;
    while (size--) {
        crc = (uint16_t)(crc ^ *data++ << 8);
        crc = (uint16_t)(crc << 4 ^ (crc >> 12) * 0x1021);
        crc = (uint16_t)(crc << 4 ^ (crc >> 12) * 0x1021);
    }
    return crc;
}

/* CRC-32 of zlib, carried on from `crc`, which is 0 at first. */
static uint32_t crc32(uint32_t crc, const uint8_t *data, uint32_t size)
{
    static const uint32_t nibble[16] = {
        0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4,
        0x4DB26158, 0x5005713C, 0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C,
        0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};
    crc = ~crc;
    while (size--) {
        crc ^= *data++;
        crc = nibble[crc & 15] ^ crc >> 4;
        crc = nibble[crc & 15] ^ crc >> 4;
    }
    return ~crc;
}

/* --- Frames ------------------------------------------------------------------------------------- */

/* Encode a frame whose payload lies at frame + 1 + RT_HEAD, in place; return its size.
 *
 * COBS: the first byte holds the distance to the first zero, and each zero that to the next. A run
 * of 254 bytes without a zero needs a byte more, for which those behind it move. */
static uint32_t seal(uint8_t *frame, uint8_t kind, uint16_t sequence, uint32_t payload)
{
    uint32_t size = 1 + RT_HEAD + payload, at, code = 0;
    uint16_t crc;
    frame[1] = kind;
    memcpy(frame + 2, &sequence, 2);
    crc = crc16(frame + 1, size - 1);
    frame[size++] = (uint8_t)(crc >> 8);
    frame[size++] = (uint8_t)crc;
    for (at = 1; at < size; at++) {
        if (at - code == 255) {
            memmove(frame + at + 1, frame + at, size - at);
            size++;
            frame[code] = 255;
            code = at;
        } else if (frame[at] == 0) {
            frame[code] = (uint8_t)(at - code);
            code = at;
        }
    }
    frame[code] = (uint8_t)(size - code);
    frame[size++] = 0;
    return size;
}

/* Decode a frame in place, without its end; return its size, 0 where it is damaged. */
static uint32_t unseal(uint8_t *frame, uint32_t size)
{
    uint32_t from = 0, to = 0;
    while (from < size) {
        uint32_t code = frame[from++], i;
        if (code == 0 || from + code - 1 > size)
            return 0;
        for (i = 1; i < code; i++)
            frame[to++] = frame[from++];
        if (code < 255 && from < size)
            frame[to++] = 0;
    }
    if (to < RT_HEAD + 2 || crc16(frame, to) != 0)
        return 0;
    return to - 2;
}

/* --- Answers ------------------------------------------------------------------------------------ */

static void refuse(struct out *o, int *code, int why, const char *text)
{
    *code = why;
    o->size = 0;
    put_u8(o, (uint8_t)why);
    put_text(o, text);
}

static void put_trip(const struct rigtool_target *t, struct out *o)
{
    static const char *const name[] = {"current", "speed", "position", "temperature"};
    static const char *const unit[] = {" A", " rad/s", " rad", " degC"};
    int which = t->trip - RIGTOOL_TARGET_BY_CURRENT;
    if (t->trip == RIGTOOL_TARGET_BY_HOST) {
        put_text(o, "stopped by the host");
    } else if (t->trip == RIGTOOL_TARGET_BY_WATCHDOG) {
        put_text(o, "the host was silent for ");
        put_number(o, t->trip_value);
        put_text(o, " s: watchdog");
    } else if (t->trip == RIGTOOL_TARGET_BY_LINE) {
        put_text(o, "the line is slower than the samples, and the memory is full: record less often");
    } else if (t->trip == RIGTOOL_TARGET_BY_DRIVE) {
        put_text(o, t->fault ? t->fault : "the drive reported a fault");
    } else {
        put_text(o, name[which]);
        put_text(o, " reached ");
        put_number(o, t->trip_value);
        put_text(o, unit[which]);
        put_text(o, ", beyond the limit of ");
        put_number(o, t->trip_limit);
        put_text(o, unit[which]);
        put_text(o, " (serial.limits): the motor was stopped and switched off");
    }
}

static void stop(struct rigtool_target *t)
{
    RIGTOOL_TARGET_LOCK();
    if (t->state == RIGTOOL_TARGET_RUNNING)
        t->trip = RIGTOOL_TARGET_BY_HOST;
    if (t->state != RIGTOOL_TARGET_TRIPPED)
        rt_stop(t, t->state == RIGTOOL_TARGET_RUNNING ? RIGTOOL_TARGET_TRIPPED : RIGTOOL_TARGET_OFF);
    t->power = 0;
    RIGTOOL_TARGET_UNLOCK();
}

static void hello(struct rigtool_target *t, struct out *o)
{
    uint16_t channels = t->config.has_temperature ? 0x1FF : 0xFF;
    stop(t);
    RIGTOOL_TARGET_LOCK();
    t->state = RIGTOOL_TARGET_OFF;
    t->recorded = t->sent = 0;
    t->watchdog_ms = 0;
    RIGTOOL_TARGET_UNLOCK();
    memset(t->object_size, 0, sizeof t->object_size);
    t->objects_used = 0;
    t->growing = 0;
    t->torque_constant = 0;
    t->sections = t->streams = 0;
    t->inertia = t->coulomb = t->viscous = 0;
    t->table = t->signal = 0;
    t->signal_size = 0;
    t->motion.kind = 0;
    t->mask = 0;
    t->limits[1] = 0;
    t->stream_size = t->stream_at = 0;
    t->in_session = 1;
    put_u8(o, RT_VERSION);
    put_u32(o, t->config.boot);
    put_u16(o, (uint16_t)(RT_ABILITIES | (t->config.keeps_log ? RT_KEEPS_LOG : 0)));
    put_u16(o, RIGTOOL_TARGET_PAYLOAD);
    put_u32(o, t->config.log_size);
    put_f8(o, t->config.sample_time);
    put_u32(o, t->config.encoder_counts);
    put_u16(o, channels);
    put_text(o, t->config.name);
}

/* --- Objects ------------------------------------------------------------------------------------ */

static void begin(struct rigtool_target *t, const uint8_t *data, struct out *o, int *code)
{
    uint32_t size = get_u32(data + 1);
    t->growing = 0;
    if (data[0] < RT_RIG || data[0] > RT_MOTION) {
        refuse(o, code, BAD_VALUE, "BEGIN of a slot that this target does not have: ");
        put_number(o, data[0]);
    } else if (size > t->config.objects_size - t->objects_used) {
        refuse(o, code, BAD_VALUE, "no memory for an object of ");
        put_number(o, size);
        put_text(o, " bytes: ");
        put_number(o, t->config.objects_size - t->objects_used);
        put_text(o, " are free");
    } else {
        t->growing = data[0];
        t->growing_size = size;
        memset(t->config.objects + t->objects_used, 0, size);
    }
}

static void chunk(struct rigtool_target *t, const uint8_t *data, uint32_t size, struct out *o,
                  int *code)
{
    uint32_t offset = get_u32(data + 1);
    if (data[0] != t->growing || !t->growing || offset > t->growing_size ||
        size - 5 > t->growing_size - offset)
        refuse(o, code, NOT_NOW, "CHUNK does not fit the size or the slot of the last BEGIN");
    else
        memcpy(t->config.objects + t->objects_used + offset, data + 5, size - 5);
}

static int all_finite(const uint8_t *data, uint32_t count)
{
    uint32_t i;
    for (i = 0; i < count; i++)
        if (!isfinite(rt_number(data, i)))
            return 0;
    return 1;
}

static int take_rig(struct rigtool_target *t, const uint8_t *data, uint32_t size)
{
    if (size < 33 || !all_finite(data, 4) || !(rt_number(data, 0) > 0) ||
        !(rt_number(data, 3) > 0) ||
        fabs(rt_number(data, 1) - t->config.sample_time) > 1e-9 * t->config.sample_time ||
        rt_number(data, 2) != t->config.encoder_counts)
        return 0;
    RIGTOOL_TARGET_LOCK();
    t->torque_constant = (rigtool_real)rt_number(data, 0);
    t->limit = (rigtool_real)rt_number(data, 3);
    RIGTOOL_TARGET_UNLOCK();
    return 1;
}

static int take_limits(struct rigtool_target *t, const uint8_t *data, uint32_t size)
{
    uint32_t i;
    if (size != 56 || !all_finite(data, 7) || !(rt_number(data, 0) > 0) ||
        !(rt_number(data, 1) > 0) || !(rt_number(data, 2) < rt_number(data, 3)) ||
        !(rt_number(data, 5) > 0) || !(rt_number(data, 6) > 0))
        return 0;
    RIGTOOL_TARGET_LOCK();
    for (i = 0; i < 6; i++)
        t->limits[i] = rt_number(data, i);
    t->watchdog_ms = (uint32_t)(rt_number(data, 6) < 4e6 ? rt_number(data, 6) * 1e3 + 1 : 4e9);
    RIGTOOL_TARGET_UNLOCK();
    return 1;
}

static int take_controller(struct rigtool_target *t, const uint8_t *data, uint32_t size)
{
    uint32_t i;
    if (size % 48 || size == 0 || size / 48 > RIGTOOL_TARGET_SECTIONS ||
        !all_finite(data, size / 8))
        return 0;
    RIGTOOL_TARGET_LOCK();
    for (i = 0; i < size / 8; i++)
        t->section[i / 6][i % 6] = rt_number(data, i);
    t->sections = (int)(size / 48);
    memset(t->section_state, 0, sizeof t->section_state);
    RIGTOOL_TARGET_UNLOCK();
    return 1;
}

/* Check an object and let it take effect; 0 where it cannot. A size of 0 removes it. */
static int take(struct rigtool_target *t, int slot, const uint8_t *data, uint32_t size)
{
    switch (slot) {
    case RT_RIG:
        return take_rig(t, data, size);
    case RT_LIMITS:
        return take_limits(t, data, size);
    case RT_CONTROLLER:
        return take_controller(t, data, size);
    case RT_FEEDFORWARD:
        if (size == 0)
            t->inertia = t->coulomb = t->viscous = 0;
        if (size != 24 || !all_finite(data, 3))
            return size == 0;
        t->inertia = (rigtool_real)rt_number(data, 0);
        t->coulomb = (rigtool_real)rt_number(data, 1);
        t->viscous = (rigtool_real)rt_number(data, 2);
        return 1;
    case RT_TABLE:
        return size == 0 || (size % 4 == 0 && all_finite(data + 12, size < 12 ? 0 : (size - 12) / 8) &&
                             rt_table(t, data, size));
    case RT_SIGNAL:
        return size % 8 == 0 && all_finite(data, size / 8);
    default: /* whether it can be followed is seen by ARM */
        return size % 8 == 1 && data[0] >= 1 && data[0] <= 5 && all_finite(data + 1, size / 8);
    }
}

/* Take an object out; those behind it move up, with `behind` bytes that grow at the end. */
static void drop(struct rigtool_target *t, int slot, uint32_t behind)
{
    uint32_t at = t->object_at[slot], size = t->object_size[slot];
    int other;
    if (!size)
        return;
    memmove(t->config.objects + at, t->config.objects + at + size,
            t->objects_used + behind - at - size);
    t->objects_used -= size;
    t->object_size[slot] = 0;
    for (other = RT_RIG; other <= RT_MOTION; other++)
        if (t->object_size[other] && t->object_at[other] > at)
            t->object_at[other] -= size;
}

static void commit(struct rigtool_target *t, const uint8_t *data, struct out *o, int *code)
{
    int slot = data[0];
    uint32_t size = get_u32(data + 1);
    const uint8_t *whole = t->config.objects + t->objects_used;
    if (slot != t->growing || !slot || size != t->growing_size ||
        crc32(0, whole, size) != get_u32(data + 5)) {
        refuse(o, code, BAD_CRC, "COMMIT: the CRC-32 is not that of the object");
    } else if (t->state == RIGTOOL_TARGET_RUNNING) {
        refuse(o, code, NOT_NOW, "COMMIT while a motion runs");
    } else if (!take(t, slot, whole, size)) {
        refuse(o, code, BAD_VALUE,
               "COMMIT: the object is not valid: its length, a number that is not finite, or values "
               "that cannot be followed; slot ");
        put_number(o, slot);
    } else {
        t->growing = 0;
        if (t->state == RIGTOOL_TARGET_ARMED)
            t->state = t->power ? RIGTOOL_TARGET_DONE : RIGTOOL_TARGET_OFF;
        drop(t, slot, size);
        t->object_at[slot] = t->objects_used;
        t->object_size[slot] = size;
        t->objects_used += size;
    }
}

/* --- Motions ------------------------------------------------------------------------------------ */

/* Refuse what moves beyond the limits of position, or without what it needs; 1 where it may. */
static int may_move(struct rigtool_target *t, double position, struct out *o, int *code)
{
    if (!t->sections || !(t->limits[1] > 0) || !(t->torque_constant > 0)) {
        refuse(o, code, NOT_NOW, "no motion before slots RIG, LIMITS, CONTROLLER were uploaded");
        return 0;
    }
    if (position >= t->limits[2] && position <= t->limits[3])
        return 1;
    refuse(o, code, NOT_NOW, "position ");
    put_number(o, position);
    put_text(o, " rad is beyond ");
    put_number(o, t->limits[2]);
    put_text(o, " to ");
    put_number(o, t->limits[3]);
    put_text(o, " rad");
    return 0;
}

static uint32_t sample_size(uint16_t mask)
{
    uint32_t size = 0;
    int channel;
    for (channel = 0; channel < RIGTOOL_TARGET_CHANNELS; channel++)
        if (mask >> channel & 1)
            size += channel < 3 ? 8 : 4;
    return size;
}

/* Say which objects are missing; 1 where there are some. */
static int missing(const struct rigtool_target *t, struct out *o, int *code)
{
    static const struct {
        int slot;
        const char *name;
    } needed[] = {{RT_RIG, "RIG"}, {RT_LIMITS, "LIMITS"}, {RT_CONTROLLER, "CONTROLLER"},
                  {RT_MOTION, "MOTION"}};
    int i, any = 0;
    for (i = 0; i < 4; i++) {
        if (t->object_size[needed[i].slot])
            continue;
        if (any)
            put_text(o, ", ");
        else
            refuse(o, code, NOT_NOW, "ARM before ");
        put_text(o, needed[i].name);
        any = 1;
    }
    if (any)
        put_text(o, " were uploaded");
    return any;
}

/* Let the interrupt find the objects where they lie now; 0 where they are not valid. */
static int prepare(struct rigtool_target *t)
{
    const uint8_t *objects = t->config.objects;
    t->signal = objects + t->object_at[RT_SIGNAL];
    t->signal_size = t->object_size[RT_SIGNAL] / 8;
    return rt_table(t, objects + t->object_at[RT_TABLE], t->object_size[RT_TABLE]) &&
           rt_motion(&t->motion, objects + t->object_at[RT_MOTION], t->object_size[RT_MOTION]);
}

static void arm(struct rigtool_target *t, const uint8_t *data, struct out *o, int *code)
{
    uint32_t every = get_u32(data), size;
    uint16_t mask, known = t->config.has_temperature ? 0x1FF : 0xFF;
    double stop_angle = rt_number(data + 4, 0), duration, steps;
    memcpy(&mask, data + 12, 2);
    if (t->state == RIGTOOL_TARGET_RUNNING) {
        refuse(o, code, NOT_NOW, "ARM while a motion runs");
        return;
    }
    if (every == 0 || mask & ~known || !(mask & 1)) {
        refuse(o, code, NOT_NOW, "ARM asks for unknown channels, or every 0th sample");
        return;
    }
    if (missing(t, o, code))
        return;
    if (!prepare(t)) {
        refuse(o, code, BAD_VALUE, "ARM: the motion or the table cannot be followed");
        return;
    }
    duration = rt_duration(&t->motion);
    steps = floor(duration / t->config.sample_time + 0.5);
    if (!(duration <= t->limits[5]) || steps > 4e9) {
        refuse(o, code, NOT_NOW, "the motion lasts ");
        put_number(o, duration);
        put_text(o, " s, the limit is ");
        put_number(o, t->limits[5]);
        put_text(o, " s");
        return;
    }
    if (t->motion.kind == 2 && !may_move(t, t->motion.number[0], o, code))
        return;
    size = sample_size(mask);
    t->capacity = t->config.log_size / size;
    t->planned = (uint32_t)steps / every;
    if (t->capacity == 0 || (t->planned > t->capacity && (t->config.keeps_log || !data[14]))) {
        refuse(o, code, NOT_NOW, "the log would take ");
        put_number(o, (double)t->planned * size);
        put_text(o, " bytes, there are ");
        put_number(o, t->config.log_size);
        put_text(o, ": record less often, or stream");
        return;
    }
    t->motion.steps = (uint32_t)steps;
    t->every = every;
    t->mask = mask;
    t->sample_size = size;
    t->streams = data[14];
    t->stop_angle = stop_angle;
    t->recorded = t->sent = 0;
    t->state = RIGTOOL_TARGET_ARMED;
    put_u32(o, t->planned);
    put_u16(o, (uint16_t)size);
}

static void start(struct rigtool_target *t, int moving_only, struct out *o, int *code)
{
    if (t->fault) {
        refuse(o, code, FAULT, t->fault);
        return;
    }
    (void)o;
    RIGTOOL_TARGET_LOCK();
    t->moving_only = moving_only;
    rt_begin(t);
    RIGTOOL_TARGET_UNLOCK();
}

static void move_by(struct rigtool_target *t, const uint8_t *data, struct out *o, int *code)
{
    double angle = rt_number(data, 0);
    double here = t->closed ? t->setpoint : rt_position(t);
    if (t->state == RIGTOOL_TARGET_RUNNING)
        refuse(o, code, NOT_NOW, "MOVE while a motion runs");
    else if (!isfinite(angle))
        refuse(o, code, BAD_VALUE, "MOVE: the angle is not finite");
    else if (may_move(t, here + angle, o, code)) {
        t->motion.kind = 3;
        t->motion.number[0] = angle;
        start(t, 1, o, code);
    }
}

/* Samples from `first` on that can be read. */
static int readable(const struct rigtool_target *t, uint32_t first, uint32_t count, struct out *o,
                    int *code)
{
    uint32_t gone = t->streams && !t->config.keeps_log ? t->sent : 0;
    if (first >= gone && count <= t->recorded && first <= t->recorded - count)
        return 1;
    refuse(o, code, NOT_NOW, "samples ");
    put_number(o, first);
    put_text(o, " to ");
    put_number(o, (double)first + count);
    put_text(o, " are not in the log: it holds ");
    put_number(o, gone);
    put_text(o, " to ");
    put_number(o, t->recorded);
    return 0;
}

static void read_log(struct rigtool_target *t, const uint8_t *data, struct out *o, int *code)
{
    uint32_t first = get_u32(data), count = get_u32(data + 4), i;
    if (!readable(t, first, count, o, code))
        return;
    if (count > (RIGTOOL_TARGET_PAYLOAD - 4) / (t->sample_size ? t->sample_size : 1)) {
        refuse(o, code, NOT_NOW, "READ of more samples than a frame holds");
        return;
    }
    put_u32(o, first);
    for (i = 0; i < count; i++)
        put(o, t->config.log + (first + i) % t->capacity * t->sample_size, t->sample_size);
}

static void digest(struct rigtool_target *t, const uint8_t *data, struct out *o, int *code)
{
    uint32_t first = get_u32(data), count = get_u32(data + 4), crc = 0, i;
    if (!readable(t, first, count, o, code))
        return;
    for (i = 0; i < count; i++)
        crc = crc32(crc, t->config.log + (first + i) % t->capacity * t->sample_size,
                    t->sample_size);
    put_u32(o, crc);
}

static void status(struct rigtool_target *t, struct out *o)
{
    int state;
    struct rigtool_target_reading now;
    uint32_t recorded;
    double time;
    RIGTOOL_TARGET_LOCK();
    state = t->state;
    recorded = t->recorded;
    now = t->reading;
    time = rt_time(t);
    RIGTOOL_TARGET_UNLOCK();
    if (t->streams && state >= RIGTOOL_TARGET_DONE &&
        (t->sent < recorded || t->stream_at < t->stream_size))
        state = RIGTOOL_TARGET_RUNNING; /* all samples go out before the end is reported */
    put_u32(o, t->config.boot);
    put_u8(o, (uint8_t)state);
    put_u32(o, recorded);
    put_f8(o, time);
    put_f8(o, now.encoder * t->count);
    put_f8(o, now.current);
    put_f8(o, now.degc);
    if (state == RIGTOOL_TARGET_TRIPPED)
        put_trip(t, o);
}

/* --- Requests ----------------------------------------------------------------------------------- */

/* Do a request that has the right length. */
static void answer(struct rigtool_target *t, int kind, const uint8_t *data, uint32_t size,
                   struct out *o, int *code)
{
    switch (kind) {
    case HELLO:
        hello(t, o);
        break;
    case BEGIN:
        begin(t, data, o, code);
        break;
    case CHUNK:
        chunk(t, data, size, o, code);
        break;
    case COMMIT:
        commit(t, data, o, code);
        break;
    case ARM:
        arm(t, data, o, code);
        break;
    case START:
        if (t->state == RIGTOOL_TARGET_ARMED)
            start(t, 0, o, code);
        else
            refuse(o, code, NOT_NOW, "START without ARM");
        break;
    case STATUS:
        status(t, o);
        break;
    case READ:
        read_log(t, data, o, code);
        break;
    case DIGEST:
        digest(t, data, o, code);
        break;
    case MOVE:
        move_by(t, data, o, code);
        break;
    case BYE:
        t->in_session = 0;
        stop(t);
        break;
    default:
        stop(t);
    }
}

static void request(struct rigtool_target *t, uint8_t *frame, uint32_t size)
{
    static const struct {
        const char *name;
        uint8_t least, most_is_more;
    } form[] = {{0, 0, 0},       {"HELLO", 1, 1},  {"BEGIN", 5, 0}, {"CHUNK", 5, 1},
                {"COMMIT", 9, 0}, {"ARM", 15, 0},   {"START", 0, 0}, {"STATUS", 0, 0},
                {"READ", 8, 0},   {"DIGEST", 8, 0}, {"STOP", 0, 0},  {"MOVE", 8, 0},
                {0, 0, 0},        {0, 0, 0},        {0, 0, 0},       {"BYE", 0, 0}};
    int kind = frame[0], code = 0;
    uint32_t length = size - RT_HEAD;
    uint16_t sequence;
    struct out o;
    memcpy(&sequence, frame + 1, 2);
    t->heard = 1;
    if (t->has_answered && sequence == t->answered && kind != HELLO) {
        t->answer_was_cut = t->answer_at > 0 && t->answer_at < t->answer_size;
        t->answer_at = 0;
        return;
    }
    o.at = t->answer + 1 + RT_HEAD;
    o.size = 0;
    t->answer_was_cut = t->answer_at > 0 && t->answer_at < t->answer_size;
    if (kind > BYE || !form[kind].name) {
        refuse(&o, &code, BAD_VALUE, "request ");
        put_number(&o, kind);
        put_text(&o, " is not known to this target");
    } else if (!t->in_session && kind != HELLO) {
        refuse(&o, &code, NO_SESSION, "the target was switched on or reset");
    } else if (length < form[kind].least || (length > form[kind].least && !form[kind].most_is_more)) {
        refuse(&o, &code, BAD_VALUE, form[kind].name);
        put_text(&o, ": wrong length");
    } else {
        answer(t, kind, frame + RT_HEAD, length, &o, &code);
    }
    t->answer_size = seal(t->answer, code ? RT_REFUSED : (uint8_t)(kind | RT_REPLY), sequence, o.size);
    t->answer_at = 0;
    t->answered = sequence;
    t->has_answered = 1;
}

void rigtool_target_receive(struct rigtool_target *t, const uint8_t *bytes, size_t count)
{
    while (count--) {
        uint8_t byte = *bytes++;
        if (byte) {
            if (t->received_size < sizeof t->received)
                t->received[t->received_size] = byte;
            if (t->received_size <= sizeof t->received)
                t->received_size++;
            continue;
        }
        if (t->received_size && t->received_size <= sizeof t->received) {
            uint32_t size = unseal(t->received, t->received_size);
            if (size)
                request(t, t->received, size);
        }
        t->received_size = 0;
    }
}

/* Put the next samples into a frame, if the stream is behind. */
static void fill_stream(struct rigtool_target *t)
{
    uint32_t count, most = (RIGTOOL_TARGET_PAYLOAD - 4) / (t->sample_size ? t->sample_size : 1), i;
    struct out o;
    count = t->recorded - t->sent;
    if (!t->streams || !t->in_session || count == 0)
        return;
    most = most < RT_STREAMED ? most : RT_STREAMED;
    if (count < most && t->state == RIGTOOL_TARGET_RUNNING)
        return; /* whole frames, except the last */
    count = count < most ? count : most;
    o.at = t->stream + 1 + RT_HEAD;
    o.size = 0;
    put_u32(&o, t->sent);
    for (i = 0; i < count; i++)
        put(&o, t->config.log + (t->sent + i) % t->capacity * t->sample_size, t->sample_size);
    t->stream_size = seal(t->stream, RT_SAMPLES, (uint16_t)(t->sent / RT_STREAMED), o.size);
    t->stream_at = 0;
    t->sent += count;
}

size_t rigtool_target_send(struct rigtool_target *t, uint8_t *bytes, size_t room)
{
    size_t sent = 0;
    while (sent < room) {
        int in_stream = t->stream_at > 0 && t->stream_at < t->stream_size;
        if (t->answer_was_cut) { /* end the frame that another answer follows */
            bytes[sent++] = 0;
            t->answer_was_cut = 0;
        } else if (!in_stream && t->answer_at < t->answer_size) {
            bytes[sent++] = t->answer[t->answer_at++];
        } else if (t->stream_at < t->stream_size) {
            bytes[sent++] = t->stream[t->stream_at++];
        } else {
            fill_stream(t);
            if (t->stream_at == t->stream_size)
                break;
        }
    }
    return sent;
}

void rigtool_target_fault(struct rigtool_target *t, const char *fault)
{
    RIGTOOL_TARGET_LOCK();
    t->fault = fault;
    if (fault && t->state == RIGTOOL_TARGET_RUNNING) {
        t->trip = RIGTOOL_TARGET_BY_DRIVE;
        rt_stop(t, RIGTOOL_TARGET_TRIPPED);
    } else if (fault) {
        rt_stop(t, RIGTOOL_TARGET_OFF);
    }
    RIGTOOL_TARGET_UNLOCK();
}

void rigtool_target_init(struct rigtool_target *t, const struct rigtool_target_config *config)
{
    memset(t, 0, sizeof *t);
    t->config = *config;
    t->count = 2 * 3.14159265358979323846 / config->encoder_counts;
    t->reading.degc = (rigtool_real)NAN;
}
