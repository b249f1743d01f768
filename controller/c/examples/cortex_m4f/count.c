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

int main(void)
{
    static dq_state loop;
    static dq_demodulator sensor;
    static count demodulate, step, init;
    const dq_params params = DQ_PLATE_PARAMS;
    dq_response response = {0};
    dq_output out = {0};
    uint32_t phase = 0, before;
    board_init();
    before = board_clock();
    nothing = since(before);
    before = board_clock();
    dq_init(&loop, &params);
    add(&init, since(before));
    dq_demodulator_init(&sensor, &params);
    for (uint32_t k = 0; k < STEPS; k++) {
        dq_input in = {.reference = k < REST ? 0 : (dq_real)DQ_PLATE_AMPLITUDE, .share = 1, .enable = 1};
        for (int n = 0; n < SAMPLES; n++) {
            const uint32_t increment = dq_dds_increment(out.offset, DQ_PLATE_DDS_BASE, (dq_real)DQ_PLATE_DDS_FRACTION,
                                                        (dq_real)DQ_PLATE_DDS_PER_HZ);
            const int32_t code = board_adc();
            before = board_clock();
            response = dq_demodulate(&sensor, (dq_real)code, phase - increment / 2);
            add(&demodulate, since(before));
            phase += increment;
            board_dac((float)out.voltage * sinf(1.4629180793e-9f * (float)phase)); /* 2 pi / 2^32 */
        }
        in.wd = response.wd;
        in.wq = response.wq;
        in.clipped = response.clipped;
        before = board_clock();
        out = dq_step(&loop, &in);
        add(&step, since(before));
    }
    board_write("function,mean,most\n");
    tell("dq_init", &init);
    tell("dq_demodulate", &demodulate);
    tell("dq_step", &step);
    board_exit(out.fault != 0);
    return 0;
}
