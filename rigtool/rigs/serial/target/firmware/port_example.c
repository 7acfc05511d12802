/*
 * Where a target meets the hardware: a starting point for a port of your own. See
 * docs/target-firmware.md. Functions that begin with board_ are yours to write, with what the maker
 * of the processor supplies; lines marked ADAPT are for your rig.
 */

#include "rigtool_target.h"

#ifdef WITH_SENSOR /* exported by rigtool export d.h5 --kt kt.h5 --format c-sensor -o sensor.h */
#include "sensor.h"
#endif

#define SAMPLE_TIME 125e-6   /* ADAPT: s, of the timer; rig.sample_time of the recipe */
#define ENCODER_COUNTS 4000  /* ADAPT: a turn; rig.encoder_counts of the recipe */

void board_init(void);                                   /* timer, encoder, amplifier, USB or UART */
int32_t board_encoder(void);                             /* count with turns: extend the timer's 16 bit */
float board_measured_current(void);                      /* A */
void board_set_current(float ampere);                    /* to the amplifier */
void board_power(int on);                                /* its enable input; off after a reset */
const char *board_fault(void);                           /* in words, 0 for none */
uint32_t board_milliseconds(void);                       /* since the start */
uint32_t board_boot_number(void);                        /* random, or counted in flash */
size_t board_read(uint8_t *bytes, size_t room);          /* what came; does not wait */
size_t board_write(const uint8_t *bytes, size_t count);  /* as much as fits; does not wait */
void board_feed_watchdog(void);                          /* the processor's own: it resets a hang */

static struct rigtool_target target;
static uint8_t objects[64 * 1024]; /* ADAPT: the table takes 8 bytes a value */
static uint8_t samples[64 * 1024]; /* ADAPT: 20 bytes a sample with four channels */

#ifdef WITH_SENSOR
static struct rigtool_sensor sensor;
static volatile float external_torque; /* N m, for what else the firmware does with it */

static void observe(void *context, const struct rigtool_target_sample *sample)
{
    struct rigtool_sensor_sample now;
    const struct rigtool_sensor_reading *reading;
    (void)context;
    now.encoder = sample->reading.encoder;
    now.current = sample->asked;
    now.temperature = sample->reading.degc;
    reading = rigtool_sensor_update(&sensor, now);
    if (reading->fresh)
        external_torque = (float)reading->torque;
}
#endif

/* The interrupt of the timer, each SAMPLE_TIME. */
void board_timer_interrupt(void)
{
    struct rigtool_target_reading now;
    now.encoder = board_encoder();
    now.current = board_measured_current();
    now.degc = 25; /* ADAPT: with has_temperature 0 it only has to be within the limit */
    now.milliseconds = board_milliseconds();
    board_set_current((float)rigtool_target_loop(&target, &now));
    board_power(rigtool_target_power(&target));
}

int main(void)
{
    struct rigtool_target_config config = {0};
    uint8_t bytes[64];
    size_t count = 0, done = 0;
    config.sample_time = SAMPLE_TIME;
    config.encoder_counts = ENCODER_COUNTS;
    config.name = "my target, firmware 1"; /* ADAPT */
    config.keeps_log = 1;                  /* 0: streams motions that do not fit into `samples` */
    config.objects = objects;
    config.objects_size = sizeof objects;
    config.log = samples;
    config.log_size = sizeof samples;
#ifdef WITH_SENSOR
    rigtool_sensor_init(&sensor);
    config.observe = observe;
#endif
    config.boot = board_boot_number();
    rigtool_target_init(&target, &config);
    board_init();
    for (;;) {
        uint8_t received[64];
        rigtool_target_receive(&target, received, board_read(received, sizeof received));
        if (done == count) {
            count = rigtool_target_send(&target, bytes, sizeof bytes);
            done = 0;
        }
        done += board_write(bytes + done, count - done);
        rigtool_target_fault(&target, board_fault());
        board_feed_watchdog();
    }
}
