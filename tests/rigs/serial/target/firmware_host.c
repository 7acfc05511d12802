/* A host for the target in C: as a library for ctypes, and as a program with a motor of its own. */

#include "rigtool_target.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static struct rigtool_target target;
static struct rigtool_target_config config = {
    125e-6, 4000, 1, "rigtool target in C, on a computer", 1, 1, 0, 1 << 23, 0, 0, 0, 0};

#ifdef WITH_SENSOR
#include "sensor.h"
#define READINGS 20000
static struct rigtool_sensor sensor;
static double readings[5 * READINGS];
static uint32_t read_so_far, seen;

static void firmware_forget(void)
{
    rigtool_sensor_init(&sensor);
    read_so_far = 0;
}

/* Torque, u, low, high and state of each reading of the last motion; returns their number. */
uint32_t firmware_readings(double *out)
{
    memcpy(out, readings, 5 * read_so_far * sizeof *out);
    return read_so_far;
}

/* Follows what the log records, all that the host receives: each motion begins anew. */
static void observe(void *context, const struct rigtool_target_sample *sample)
{
    struct rigtool_sensor_sample now;
    const struct rigtool_sensor_reading *reading;
    (void)context;
    if (target.recorded == seen)
        return;
    seen = target.recorded;
    if (seen == 1)
        firmware_forget();
    now.encoder = sample->reading.encoder;
    now.current = (rigtool_sensor_real)sample->asked;
    now.temperature = (rigtool_sensor_real)sample->reading.degc;
    reading = rigtool_sensor_update(&sensor, now);
    if (reading->fresh && read_so_far < READINGS) {
        double *out = readings + 5 * read_so_far++;
        out[0] = (double)reading->torque;
        out[1] = (double)reading->u;
        out[2] = (double)reading->low;
        out[3] = (double)reading->high;
        out[4] = (double)reading->state;
    }
}
#endif

void firmware_begin(uint32_t boot, uint32_t log_size, int keeps_log)
{
    free(config.objects);
    free(config.log);
    config.boot = boot;
    config.log_size = log_size;
    config.keeps_log = keeps_log;
    config.objects = malloc(config.objects_size);
    config.log = malloc(log_size);
#ifdef WITH_SENSOR
    config.observe = observe;
#endif
    rigtool_target_init(&target, &config);
}

void firmware_receive(const uint8_t *bytes, uint32_t count)
{
    rigtool_target_receive(&target, bytes, count);
}

uint32_t firmware_send(uint8_t *bytes, uint32_t room)
{
    return (uint32_t)rigtool_target_send(&target, bytes, room);
}

/* Run the interrupt for samples of encoder, current and temperature; give what it asks for. */
void firmware_run(uint32_t count, const double *samples, uint32_t milliseconds, double *asked)
{
    uint32_t k;
    for (k = 0; k < count; k++) {
        struct rigtool_target_reading now;
        now.encoder = (int32_t)samples[3 * k];
        now.current = (rigtool_real)samples[3 * k + 1];
        now.degc = (rigtool_real)samples[3 * k + 2];
        now.milliseconds = milliseconds;
        asked[k] = rigtool_target_loop(&target, &now);
    }
}

/* Run the interrupt with a shaft that is always at the set point. */
void firmware_follow(uint32_t count, uint32_t milliseconds)
{
    while (count--) {
        struct rigtool_target_reading now;
        now.encoder = (int32_t)floor(target.setpoint / target.count);
        now.current = 0;
        now.degc = 25;
        now.milliseconds = milliseconds;
        rigtool_target_loop(&target, &now);
    }
}

int firmware_state(void)
{
    return target.state;
}

void firmware_fault(const char *fault)
{
    rigtool_target_fault(&target, fault);
}

/* The torque of a table, an object as the host sends it, at set points (count, 2). */
int firmware_table(const uint8_t *object, uint32_t size, uint32_t count, const double *at,
                   double *torque)
{
    uint32_t k;
    if (!rt_table(&target, object, size) || !target.table)
        return 0;
    for (k = 0; k < count; k++)
        torque[k] = rt_table_torque(&target, at[2 * k], at[2 * k + 1]);
    return 1;
}

#ifdef FIRMWARE_MAIN
#include <poll.h>
#include <time.h>
#include <unistd.h>

static uint32_t milliseconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)(now.tv_sec * 1000 + now.tv_nsec / 1000000);
}

/* A shaft with inertia and friction, on a line that is open already; ends with it. */
int main(int argc, char **argv)
{
    double angle = 0.0, speed = 0.0, current = 0.0;
    const double dt = 125e-6, inertia = 1.5e-5, constant = 0.045, coulomb = 2.3e-3;
    uint32_t then;
    int line = argc > 1 ? atoi(argv[1]) : 0;
    firmware_begin(milliseconds(), 1 << 24, 1);
    then = milliseconds();
    for (;;) {
        struct pollfd ready = {0, POLLIN, 0};
        uint8_t bytes[512];
        uint32_t now, k;
        size_t count;
        ssize_t got;
        ready.fd = line;
        if (poll(&ready, 1, 1) > 0) {
            got = read(line, bytes, sizeof bytes);
            if (got <= 0)
                break;
            firmware_receive(bytes, (uint32_t)got);
        }
        now = milliseconds();
        for (k = 0; k < 8 * (now - then < 200 ? now - then : 200); k++) {
            struct rigtool_target_reading reading;
            double torque, brake = dt * coulomb / inertia;
            reading.encoder = (int32_t)floor(angle * 4000 / (2 * 3.14159265358979));
            reading.current = (rigtool_real)current;
            reading.degc = 25;
            reading.milliseconds = now;
            current = rigtool_target_loop(&target, &reading);
            torque = constant * current - 5e-5 * speed;
            speed += dt * torque / inertia;
            speed = fabs(speed) > brake ? speed - (speed > 0 ? brake : -brake) : 0.0;
            angle += dt * speed;
        }
        then = now;
        while ((count = rigtool_target_send(&target, bytes, sizeof bytes)) > 0)
            if (write(line, bytes, count) != (ssize_t)count)
                return 3;
    }
#ifdef WITH_SENSOR
    fwrite(readings, 5 * sizeof *readings, read_so_far, stdout);
#endif
    free(config.objects);
    free(config.log);
    return 0;
}
#endif
