#ifndef RIGTOOL_TARGET_H
#define RIGTOOL_TARGET_H

/*
 * A target of rigtool: position loop, learned table, log, limits and watchdog, behind the link of
 * docs/target-link.md. C99, no allocation, no variables of its own, little-endian processors.
 *
 *     rigtool_target_init(&target, &config);             once
 *     ampere = rigtool_target_loop(&target, &reading);   in the interrupt of the timer
 *     rigtool_target_receive(&target, bytes, count);     in the main loop, with what came
 *     count = rigtool_target_send(&target, bytes, room); in the main loop: what is to go out
 *
 * Set points, time and the controller, whose poles lie close to 1, are doubles. All else is as well,
 * unless RIGTOOL_TARGET_FLOAT is defined for all files. RIGTOOL_TARGET_LOCK and _UNLOCK keep the interrupt of the timer away from
 * the main loop for some microseconds; both may be defined in rigtool_port.h, with
 * RIGTOOL_TARGET_PORT. Compile without -ffast-math: a missing temperature is NaN.
 */

#include <stddef.h>
#include <stdint.h>

#ifdef RIGTOOL_TARGET_PORT
#include "rigtool_port.h"
#endif
#ifndef RIGTOOL_TARGET_LOCK
#define RIGTOOL_TARGET_LOCK()
#define RIGTOOL_TARGET_UNLOCK()
#endif
#ifndef RIGTOOL_TARGET_PAYLOAD
#define RIGTOOL_TARGET_PAYLOAD 512 /* bytes of a frame, 128 to 60000 */
#endif
#ifndef RIGTOOL_TARGET_SECTIONS
#define RIGTOOL_TARGET_SECTIONS 6 /* second-order sections of the controller, at most */
#endif
#ifdef RIGTOOL_TARGET_FLOAT
typedef float rigtool_real;
#else
typedef double rigtool_real;
#endif

#define RIGTOOL_TARGET_FRAME (RIGTOOL_TARGET_PAYLOAD + RIGTOOL_TARGET_PAYLOAD / 254 + 9)
#define RIGTOOL_TARGET_SLOTS 9
#define RIGTOOL_TARGET_CHANNELS 9
#define RIGTOOL_TARGET_RING 32 /* samples over which speed is watched */

/* What the hardware shows at one sample of the loop. */
struct rigtool_target_reading {
    int32_t encoder;       /* quad counts, rounded down, turns included */
    rigtool_real current;  /* A, as the amplifier measures it */
    rigtool_real degc;     /* of the motor, degC; NaN without a thermometer */
    uint32_t milliseconds; /* of a clock that never stops; it may wrap around */
};

/* One sample of the loop, for what else the firmware does with it. */
struct rigtool_target_sample {
    struct rigtool_target_reading reading;
    double setpoint;    /* rad */
    rigtool_real asked; /* A: controller, feed-forward, table and signal, limited */
};

struct rigtool_target_config {
    double sample_time;      /* s, of the interrupt */
    uint32_t encoder_counts; /* a turn */
    uint32_t boot;           /* another number after each start */
    const char *name;        /* of target and firmware, with version; 64 characters at most */
    int has_temperature;
    int keeps_log;     /* 1: the log holds a whole motion. 0: streamed samples make room */
    uint8_t *objects;  /* memory for what the host sends, mostly the table: 8 bytes a value */
    uint32_t objects_size;
    uint8_t *log;
    uint32_t log_size;
    void (*observe)(void *context, const struct rigtool_target_sample *sample); /* or 0 */
    void *context;
};

enum rigtool_target_state {
    RIGTOOL_TARGET_OFF,
    RIGTOOL_TARGET_ARMED,
    RIGTOOL_TARGET_RUNNING,
    RIGTOOL_TARGET_DONE,
    RIGTOOL_TARGET_TRIPPED
};

enum rigtool_target_trip {
    RIGTOOL_TARGET_BY_HOST,
    RIGTOOL_TARGET_BY_WATCHDOG,
    RIGTOOL_TARGET_BY_CURRENT,
    RIGTOOL_TARGET_BY_SPEED,
    RIGTOOL_TARGET_BY_POSITION,
    RIGTOOL_TARGET_BY_TEMPERATURE,
    RIGTOOL_TARGET_BY_LINE,
    RIGTOOL_TARGET_BY_DRIVE
};

/* A motion, as the interrupt follows it. */
struct rigtool_target_motion {
    int kind;            /* as in the link; 0 for none */
    const uint8_t *data; /* its numbers */
    uint32_t count;
    double number[5];
    uint32_t piece; /* or stroke; with the way travelled before it */
    double travelled;
    double stroke, turn; /* of a triangle, s */
    double origin;       /* added to positions, rad */
    uint32_t step, steps;
};

/* The lines of the table on either side of the last speed. */
struct rigtool_target_lines {
    int valid;
    uint32_t line;
    int32_t row[2];
    rigtool_real factor[2], low, high, slope;
};

/* Everything below changes under the functions of rigtool_target.c alone. */
struct rigtool_target {
    struct rigtool_target_config config;
    /* the line */
    uint8_t received[RIGTOOL_TARGET_FRAME];
    uint32_t received_size;
    uint8_t answer[RIGTOOL_TARGET_FRAME], stream[RIGTOOL_TARGET_FRAME];
    uint32_t answer_size, answer_at, stream_size, stream_at;
    uint16_t answered;
    int has_answered, answer_was_cut, in_session;
    /* objects: packed in the order of their coming */
    uint32_t object_at[RIGTOOL_TARGET_SLOTS], object_size[RIGTOOL_TARGET_SLOTS];
    uint32_t objects_used, growing_size;
    int growing;
    /* the log: a ring of samples */
    uint32_t every, capacity, sample_size, planned;
    uint32_t sent; /* streamed */
    uint16_t mask;
    int streams;
    /* shared with the interrupt */
    volatile uint32_t recorded;
    volatile int state, power, heard, moving_only;
    volatile int trip;
    double trip_value, trip_limit;
    const char *fault; /* of the drive */
    uint32_t fed;      /* ms */
    uint32_t watchdog_ms;
    struct rigtool_target_reading reading;
    uint32_t ticks_low, ticks_high; /* samples since the start */
    /* the loop */
    int closed;
    double setpoint, count;
    rigtool_real torque_constant, limit;
    double section[RIGTOOL_TARGET_SECTIONS][6], section_state[RIGTOOL_TARGET_SECTIONS][2];
    int sections;
    rigtool_real inertia, coulomb, viscous;
    double limits[6]; /* current, speed, lowest and highest position, temperature, duration */
    struct rigtool_target_motion approach, settle, motion;
    int phase; /* 0 approach, 1 settle, 2 motion */
    double stop_angle, begin;
    uint32_t table_columns, table_rows, table_low, table_negative, table_lines;
    double table_start, table_step;
    struct rigtool_target_lines lines;
    const uint8_t *table, *signal;
    uint32_t signal_size, signal_at;
    int32_t ring[RIGTOOL_TARGET_RING];
    uint32_t ring_filled, ring_at, current_samples, current_window;
    int32_t most_moved, lowest, highest; /* counts */
    rigtool_real hottest;
    rigtool_real current_sum;
    double sum[RIGTOOL_TARGET_CHANNELS];
    uint32_t summed;
};

void rigtool_target_init(struct rigtool_target *t, const struct rigtool_target_config *config);

/* Take one sample of the loop; return the current to set, A. The power stage belongs on where
 * rigtool_target_power returns 1, afterwards. */
rigtool_real rigtool_target_loop(struct rigtool_target *t,
                                 const struct rigtool_target_reading *reading);
int rigtool_target_power(const struct rigtool_target *t);

/* Take bytes that came from the host. */
void rigtool_target_receive(struct rigtool_target *t, const uint8_t *bytes, size_t count);

/* Give out up to `room` bytes that go to the host; return how many. */
size_t rigtool_target_send(struct rigtool_target *t, uint8_t *bytes, size_t room);

/* The drive has a fault, in words that stay valid: the motor is switched off, and stays so until
 * the fault is 0 again. */
void rigtool_target_fault(struct rigtool_target *t, const char *fault);

/* Between rigtool_target.c, which speaks with the host, and rigtool_loop.c, the interrupt. */
enum { RT_RIG = 1, RT_LIMITS, RT_CONTROLLER, RT_FEEDFORWARD, RT_TABLE, RT_SIGNAL, RT_MOTION };
double rt_number(const uint8_t *data, uint32_t index);
int rt_motion(struct rigtool_target_motion *motion, const uint8_t *data, uint32_t size);
double rt_duration(const struct rigtool_target_motion *motion);
void rt_move(struct rigtool_target_motion *motion, double angle, double duration);
int rt_table(struct rigtool_target *t, const uint8_t *data, uint32_t size);
rigtool_real rt_table_torque(struct rigtool_target *t, double position, double speed);
void rt_begin(struct rigtool_target *t);
void rt_stop(struct rigtool_target *t, int state);
double rt_time(const struct rigtool_target *t);
double rt_position(const struct rigtool_target *t);
void rt_sample(const struct rigtool_target *t, uint32_t number, uint8_t *data);

#endif
