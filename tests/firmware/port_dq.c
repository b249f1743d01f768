/* The exported controller, as its header has it. */
#include "port.h"

#include "dq_pi_plate.h"

#define NEVER 16777216 /* steps: the most that a parameter takes */

static dq_state loop;
static dq_demodulator sensor;
static int guarded = 1;

/* Parameters with which nothing is called a fault, so that a loop may be seen to oscillate. */
static dq_params unguarded(dq_params p)
{
    p.jump = (dq_real)1e30;
    p.patience = p.repeats = p.doubts = p.follows = p.swings = NEVER;
    p.ceiling = 10;
    return p;
}

int port_init(void)
{
    const dq_params params = DQ_PLATE_PARAMS;
    dq_demodulator_init(&sensor, &params);
    return (int)dq_init(&loop, &params);
}

void port_sample(double sample, uint32_t phase, port_response *found)
{
    const dq_response r = dq_demodulate(&sensor, (dq_real)sample, phase);
    *found = (port_response){r.wd, r.wq, r.clipped, r.samples};
}

port_output port_step(const port_input *given)
{
    const dq_input in = {
        .reference = (dq_real)given->reference, .share = (dq_real)given->share,
        .wd = (dq_real)given->wd, .wq = (dq_real)given->wq, .temperature = (dq_real)given->temperature,
        .voltage = (dq_real)given->voltage, .offset = (dq_real)given->offset, .task = given->task,
        .clipped = given->clipped, .samples = given->samples, .enable = given->enable, .reset = given->reset,
    };
    dq_output out;
    if (given->guard != guarded) {
        const dq_params params = DQ_PLATE_PARAMS, free = unguarded(params);
        guarded = given->guard;
        dq_set(&loop, guarded ? &params : &free);
    }
    out = dq_step(&loop, &in);
    return (port_output){out.voltage, out.frequency, out.fault, out.mode};
}
