/* Anything that may come in, and parameters that were changed at random: what a controller gives out is
 * always within its limits.
 *
 * fuzz COUNT SEED: prints the first violation and returns 1. */
#include "dq_pi_plate.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t chance;

static double even(void)
{
    uint64_t z = (chance += 0x9e3779b97f4a7c15u); /* splitmix64 */
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) / 9007199254740992.0;
}

/* Usually something sensible about `size`, sometimes anything. */
static dq_real any(double size)
{
    static const double odd[] = {0, -0.0, 1e-45, -1e-38, 1e30, -1e30, 3.4e38, -3.4e38, 1e300, 16777217};
    const double u = even();
    if (u < 0.02)
        return (dq_real)NAN;
    if (u < 0.04)
        return u < 0.03 ? (dq_real)INFINITY : -(dq_real)INFINITY;
    if (u < 0.08)
        return (dq_real)odd[(int)(even() * sizeof odd / sizeof odd[0])];
    return (dq_real)(size * (u < 0.5 ? 1 : 3 * even() - 1));
}

/* One number of the parameters is another. */
static void changed(dq_params *p)
{
    const size_t at = sizeof(uint32_t) * (size_t)(even() * (sizeof *p / sizeof(uint32_t)));
    if (at + sizeof(dq_real) <= sizeof *p && even() < 0.5) {
        dq_real value;
        memcpy(&value, (char *)p + at, sizeof value);
        value *= (dq_real)(even() < 0.5 ? 4 * even() : -even());
        memcpy((char *)p + at, &value, sizeof value);
    } else {
        const uint32_t word = (uint32_t)(even() * 4294967296.0);
        memcpy((char *)p + at, &word, sizeof word);
    }
}

static int broken(const dq_params *p, const dq_output *out, const char **what)
{
    const int off = out->mode == DQ_MODE_OFF || out->mode == DQ_MODE_FAULT;
    const dq_real room = (dq_real)1e-6 * p->frequency_highest; /* f0 and an offset are added */
    const int volts = out->voltage >= p->voltage_lowest && out->voltage <= p->voltage_highest;
    const dq_real f = out->frequency;
    const int hertz = f >= p->frequency_lowest - room && f <= p->frequency_highest + room;
    const int mode = out->mode >= 0 && out->mode <= DQ_MODE_SWEEP;
    const int fault = out->fault >= 0 && out->fault <= DQ_FAULT_PARAMETERS;
    *what = !volts ? "voltage beyond its limits"
        : !hertz ? "frequency beyond its window"
        : off && out->voltage != 0 ? "a voltage while it is off"
        : (out->fault != DQ_FAULT_NONE) != (out->mode == DQ_MODE_FAULT) ? "a fault beside the mode"
        : !mode || !fault ? "an unknown word"
        : NULL;
    return *what != NULL;
}

static dq_input drawn(const dq_params *p, double quiet)
{
    const double W = p->amplitude * even();
    dq_input in = {
        .reference = even() < quiet ? p->amplitude : any(p->amplitude), .share = even() < quiet ? 1 : any(1),
        .wd = even() < quiet ? (dq_real)W : any(p->amplitude),
        .wq = even() < quiet ? (dq_real)(0.1 * W) : any(p->amplitude),
        .temperature = any(24), .voltage = any(p->voltage_highest), .offset = any(100),
        .task = even() < 0.99 ? (int32_t)(4 * even()) : (int32_t)(4e9 * (even() - 0.5)),
        .clipped = even() < 0.01, .enable = even() < 0.999, .reset = even() < 0.01,
    };
    return in;
}

int main(int count, char **words)
{
    const dq_params first = DQ_PLATE_PARAMS;
    const long steps = count > 1 ? atol(words[1]) : 100000;
    dq_params p = first;
    static dq_state loop;
    static dq_demodulator sensor;
    chance = count > 2 ? strtoull(words[2], NULL, 10) : 1;
    dq_init(&loop, &p);
    dq_demodulator_init(&sensor, &p);
    for (long k = 0; k < steps; k++) {
        const char *what;
        dq_input in;
        dq_output out;
        if (k % 500 == 0) { /* another plate, mostly one that cannot be */
            dq_params other = even() < 0.3 ? first : p;
            if (even() < 0.7)
                changed(&other);
            if (dq_set(&loop, &other) == DQ_PARAMS_OK)
                p = other;
        }
        in = drawn(&p, k / 500 % 2 == 0 ? 0.99 : 0.5);
        (void)dq_demodulate(&sensor, any(100), (uint32_t)(even() * 4294967296.0));
        out = dq_step(&loop, &in);
        if (broken(&p, &out, &what)) {
            printf("step %ld: %s: mode %d, fault %d, %g, %g Hz;", k, what, (int)out.mode, (int)out.fault,
                   (double)out.voltage, (double)out.frequency);
            for (size_t at = 0; at < sizeof p; at += 4)
                if (memcmp((char *)&p + at, (const char *)&first + at, 4) != 0)
                    printf(" word %d of the parameters", (int)(at / 4));
            printf("\n");
            return 1;
        }
    }
    return 0;
}
