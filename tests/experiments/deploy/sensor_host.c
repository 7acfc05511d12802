/* A host for the exported sensor: as a library for ctypes, and as a program between two pipes. */
#include "sensor.h"
#include <stdio.h>

static struct rigtool_sensor sensor;

void sensor_begin(void);
void sensor_gap(void);
int sensor_run(int count, const double *samples, double *readings);

void sensor_begin(void)
{
    rigtool_sensor_init(&sensor);
}

void sensor_gap(void)
{
    rigtool_sensor_gap(&sensor);
}

/* Samples of encoder, current and temperature in, readings of torque, u, low, high and state out. */
int sensor_run(int count, const double *samples, double *readings)
{
    int i, found = 0;
    for (i = 0; i < count; i++) {
        struct rigtool_sensor_sample sample;
        const struct rigtool_sensor_reading *now;
        sample.encoder = (int32_t)samples[3 * i];
        sample.current = (rigtool_sensor_real)samples[3 * i + 1];
        sample.temperature = (rigtool_sensor_real)samples[3 * i + 2];
        now = rigtool_sensor_update(&sensor, sample);
        if (now->fresh) {
            double *out = readings + 5 * found++;
            out[0] = (double)now->torque;
            out[1] = (double)now->u;
            out[2] = (double)now->low;
            out[3] = (double)now->high;
            out[4] = (double)now->state;
        }
    }
    return found;
}

int main(void)
{
    double sample[3], reading[5];
    sensor_begin();
    while (fread(sample, sizeof sample, 1, stdin) == 1)
        if (sensor_run(1, sample, reading))
            fwrite(reading, sizeof reading, 1, stdout);
    return 0;
}
