/* An amplitude loop on a Cortex-M4F: one interrupt for each sample, one for each control step, and a record of
 * the start. The plate's header must be for the rig of rig.toml.
 *
 * The synthesiser is an accumulator of 32 bits, advanced at each sample. Its sine is put out at a sample and held
 * until the next, so that the drive lags the accumulator by half an increment: this is counted where the phase is
 * handed to the demodulator. */
#include "board.h"

#include "dq_pi_plate.h"

#include <math.h>
#include <stdio.h>

#ifndef DQ_PLATE_DDS_BASE
#error "export with the rig of rig.toml: dds_MHz says how an increment is made of a frequency"
#endif

#define ROWS 600 /* of the record */
#define REST 20  /* of them before the amplitude is asked for */
#define TABLE 1024u

typedef struct {
    dq_real wd, wq, voltage, frequency;
} row;

static dq_state loop;
static dq_demodulator sensor;
static dq_response response; /* the latest; written by the sample interrupt */
static dq_output command;    /* what the next control interrupt puts into force */
static volatile dq_real peak; /* V */
static volatile uint32_t increment;
static uint32_t phase; /* of what the converter shows from this event on */
static float sine[TABLE];
static row rows[ROWS];
static volatile uint32_t count;

void sample_interrupt(void)
{
    const uint32_t step = increment;
    response = dq_demodulate(&sensor, (dq_real)board_adc(), phase - step / 2);
    phase += step;
    board_dac((float)peak * sine[(phase + 0x200000u) >> 22]); /* to the nearest of the table */
}

/* The command takes effect exactly one step after its reading, however long the step takes to compute. */
void control_interrupt(void)
{
    dq_input in = {.reference = count < REST ? 0 : (dq_real)DQ_PLATE_AMPLITUDE, .share = 1, .enable = 1};
    const dq_output now = command;
    peak = now.voltage;
    increment = dq_dds_increment(now.offset, DQ_PLATE_DDS_BASE, (dq_real)DQ_PLATE_DDS_FRACTION,
                                 (dq_real)DQ_PLATE_DDS_PER_HZ);
    board_lock();
    in.wd = response.wd;
    in.wq = response.wq;
    in.clipped = response.clipped;
    in.samples = response.samples;
    board_unlock();
    command = dq_step(&loop, &in);
    if (count < ROWS) { /* the reading, and what is driven from it on */
        rows[count] = (row){in.wd, in.wq, now.voltage, now.frequency};
        count++;
    }
}

static void write_record(const dq_output *last)
{
    char line[120];
    snprintf(line, sizeof line, "# mode: %d\n# fault: %d\n# stack_bytes: %lu\n", (int)last->mode, (int)last->fault,
             (unsigned long)board_stack());
    board_write(line);
    board_write(DQ_PLATE_RECORD_HEADER);
    for (uint32_t k = 0; k < ROWS; k++) {
        const row *r = &rows[k];
        snprintf(line, sizeof line, DQ_PLATE_RECORD_FORMAT, k * DQ_PLATE_SAMPLE_TIME, (double)r->wd,
                 (double)r->wq, (double)r->voltage, (double)r->frequency);
        board_write(line);
    }
}

int main(void)
{
    const dq_params params = DQ_PLATE_PARAMS;
    const dq_input rest = {.share = 1};
    dq_output last;
    board_init();
    for (uint32_t k = 0; k < TABLE; k++)
        sine[k] = sinf(6.2831853f / TABLE * (float)k);
    if (dq_init(&loop, &params) != DQ_PARAMS_OK || dq_self_test() != 0)
        board_exit(1);
    dq_demodulator_init(&sensor, &params);
    command = dq_step(&loop, &rest); /* without voltage, at the frequency to begin with */
    board_start((uint32_t)(1e6 * DQ_PLATE_SAMPLE_TIME + 0.5));
    while (count < ROWS)
        board_wait();
    last = command;
    write_record(&last);
    board_exit(0);
    return 0;
}
