/* How many instructions each function takes: the loop of main.c without interrupts, each call timed.
 *
 * For an emulator in which an instruction takes 128 ns of its clock (-icount shift=7), 3.2 counts of the
 * timer. */
#include "board.h"

#include "dq_pi_plate.h"

#include <math.h>
#include <stdio.h>

#define STEPS 600
#define SAMPLES 52 /* in a step */
#define REST 20

typedef struct {
    uint32_t calls, sum, most;
} count;

static uint32_t nothing; /* what reading the clock twice takes itself */

static uint32_t since(uint32_t before)
{
    const uint32_t ticks = (before - board_clock()) & 0xffffffu;
    return (ticks * 10u + 16u) / 32u - nothing;
}

static void add(count *c, uint32_t instructions)
{
    c->calls++;
    c->sum += instructions;
    if (instructions > c->most)
        c->most = instructions;
}

static void tell(const char *name, const count *c)
{
    char line[80];
    const unsigned long mean = (c->sum + c->calls / 2) / c->calls;
    snprintf(line, sizeof line, "%s,%lu,%lu\n", name, mean, (unsigned long)c->most);
    board_write(line);
}

void sample_interrupt(void)
{
}

void control_interrupt(void)
{
}

/* Counts a call of a function that is told by its name. */
#define COUNT(c, call) \
    do { \
        const uint32_t before = board_clock(); \
        call; \
        add(&(c), since(before)); \
    } while (0)
#define ONCE(name, call) \
    do { \
        count once = {0}; \
        COUNT(once, call); \
        tell(name, &once); \
    } while (0)

/* What is called now and then, once each. */
static void count_others(dq_state *loop, dq_demodulator *sensor, const dq_params *params)
{
    static const dq_real series[3] = {(dq_real)0.5, (dq_real)0.1, (dq_real)0.02};
    const volatile dq_real offset = 30, volts = 100;
    volatile int32_t code;
    volatile dq_real duty;
    dq_params timer = *params;
    timer.source_periods = 3096;
    timer.source_centre = (dq_real)32300;
    (void)code;
    (void)duty;
    ONCE("dq_init", dq_init(loop, params));
    ONCE("dq_set", dq_set(loop, params));
    ONCE("dq_check_params", dq_check_params(params));
    ONCE("dq_demodulator_init", dq_demodulator_init(sensor, params));
    ONCE("dq_self_test", code = dq_self_test());
    ONCE("dq_dac_code", code = dq_dac_code(volts, 12, (dq_real)400));
    ONCE("dq_duty", duty = dq_duty(volts, (dq_real)160, series, 3));
    ONCE("dq_timer_ticks", code = (int32_t)dq_timer_ticks(&timer, offset));
    ONCE("dq_dds_increment", code = (int32_t)dq_dds_increment(offset, DQ_PLATE_DDS_BASE, (dq_real)DQ_PLATE_DDS_FRACTION,
                                                              (dq_real)DQ_PLATE_DDS_PER_HZ));
}

int main(void)
{
    static dq_state loop;
    static dq_demodulator sensor;
    static count demodulate, step;
    const dq_params params = DQ_PLATE_PARAMS;
    dq_response response = {0};
    dq_output out = {0};
    uint32_t phase = 0, before;
    board_init();
    before = board_clock();
    nothing = since(before);
    board_write("function,mean,most\n");
    count_others(&loop, &sensor, &params);
    for (uint32_t k = 0; k < STEPS; k++) {
        dq_input in = {.reference = k < REST ? 0 : (dq_real)DQ_PLATE_AMPLITUDE, .share = 1, .enable = 1};
        for (int n = 0; n < SAMPLES; n++) {
            const uint32_t increment = dq_dds_increment(out.offset, DQ_PLATE_DDS_BASE, (dq_real)DQ_PLATE_DDS_FRACTION,
                                                        (dq_real)DQ_PLATE_DDS_PER_HZ);
            const int32_t code = board_adc();
            COUNT(demodulate, response = dq_demodulate(&sensor, (dq_real)code, phase - increment / 2));
            phase += increment;
            board_dac((float)out.voltage * sinf(1.4629180793e-9f * (float)phase)); /* 2 pi / 2^32 */
        }
        in.wd = response.wd;
        in.wq = response.wq;
        in.clipped = response.clipped;
        in.samples = response.samples;
        COUNT(step, out = dq_step(&loop, &in));
    }
    tell("dq_demodulate", &demodulate);
    tell("dq_step", &step);
    board_exit(out.fault != 0);
    return 0;
}
